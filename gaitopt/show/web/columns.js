// Columns of numbers packed by film.py: value = low + step * code; all low bytes, then all high bytes, in base64.

function unpack({ rows, columns }) {
  const unpacked = {};
  for (const [name, [low, step, text]] of Object.entries(columns)) {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    unpacked[name] = Float64Array.from({ length: rows }, (_, k) => low + (text ? step * (bytes[k] + 256 * bytes[rows + k]) : 0));
  }
  return unpacked;
}

const SMOOTH = 33; // smallest number of equidistant points of a phase on the page
const PER_SECOND = 90;

// A film whose columns are equidistant within each phase and close enough for straight lines between them; all x are
// counted from the start of the cycle.
function unrolled(film) {
  const nodes = unpack(film.frames);
  const phases = [];
  const columns = Object.fromEntries(Object.keys(nodes).map((name) => [name, []]));
  for (const phase of film.phases) {
    const count = Math.max(SMOOTH, Math.ceil(PER_SECOND * (phase.end - phase.start)));
    const weights = interpolation(phase.last - phase.first + 1, count);
    const first = columns.x0.length;
    for (const [name, values] of Object.entries(nodes)) {
      const origin = /^x\d+$/.test(name) ? phase.origin : 0;
      for (const row of weights) columns[name].push(row.reduce((sum, weight, k) => sum + weight * values[phase.first + k], origin));
    }
    phases.push({ ...phase, first, last: first + count - 1 });
  }
  return { ...film, phases, columns };
}

const interpolations = new Map();

// Weights of values at Chebyshev points of the second kind at `count` equidistant points: barycentric interpolation.
function interpolation(points, count) {
  const key = `${points} ${count}`;
  if (!interpolations.has(key)) interpolations.set(key, Array.from({ length: count }, (_, k) => weightsAt(points, (2 * k) / (count - 1) - 1)));
  return interpolations.get(key);
}

function weightsAt(points, s) {
  const nodes = Array.from({ length: points }, (_, k) => -Math.cos((Math.PI * k) / (points - 1)));
  const exact = nodes.findIndex((node) => Math.abs(node - s) < 1e-12);
  if (exact >= 0) return nodes.map((_, k) => (k === exact ? 1 : 0));
  const weights = nodes.map((node, k) => ((-1) ** k * (k === 0 || k === points - 1 ? 0.5 : 1)) / (s - node));
  const sum = weights.reduce((total, weight) => total + weight, 0);
  return weights.map((weight) => weight / sum);
}
