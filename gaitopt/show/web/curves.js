// The figures of one gait: portrait, forces, slip, torques, multipliers; dashed where the foot slips.
// `fellows` are all motions of the page, with this one: they share their axes.

const COLOURS = ["first", "second", "third", "fourth", "fifth", "sixth", "seventh"];
const CARRIES = 0.01; // smallest normal force with a force ratio, relative to the weight
const LEAP = 1e-3; // smallest jump of a state, relative to its range
const REACH = 1.5; // half width of the plane of multipliers; larger ones are at its edge with their value

// Times, columns and phases of an unrolled film, and the slip of every contact.
function motion(film) {
  const t = new Float64Array(film.columns.x0.length);
  for (const { start, end, first, last } of film.phases)
    for (let k = first; k <= last; k += 1) t[k] = start + ((end - start) * (k - first)) / (last - first);
  const slipped = film.contacts.map(({ mark }, n) => slipSince(film, film.columns[`x${mark}`], n));
  return { film, t, slipped, ...film.columns };
}

// Slip of a contact [mm] since it landed, and of a single foot since its step began; NaN where it is off the ground.
function slipSince({ phases, contacts }, x, n) {
  const slipped = new Float64Array(x.length).fill(NaN);
  let landed, step;
  for (const phase of phases) {
    if (phase.step !== step || !phase.contacts[n]) landed = contacts.length === 1 ? phase.origin : undefined;
    step = phase.step;
    if (!phase.contacts[n]) continue;
    landed ??= x[phase.first];
    for (let k = phase.first; k <= phase.last; k += 1) slipped[k] = 1000 * (x[k] - landed);
  }
  return slipped;
}

// First and last point of every step.
function stepEnds({ phases }) {
  return Array.from({ length: phases.at(-1).step + 1 }, (_, step) => {
    const own = phases.filter((phase) => phase.step === step);
    return [own[0].first, own.at(-1).last];
  });
}

const STROKES = { stick: "", flight: "flying" };

// The mode of all contacts of a phase: stick if any sticks, slip if all on the ground slip, flight if none touches it.
function overall(contacts) {
  const touching = contacts.filter((mode) => mode);
  return touching.length === 0 ? "flight" : touching.includes("stick") ? "stick" : "slip";
}

// Draw y versus x, phase by phase, where y is a number: there is no force in flight. A line is dashed where the contact
// with number n slips; without a number, where all on the ground do.
function stroke(chart, moving, x, y, colour, n, style = "") {
  for (const { contacts, first, last } of moving.film.phases) {
    const mode = n === undefined ? overall(contacts) : contacts[n] ?? "flight";
    const points = Array.from({ length: last - first + 1 }, (_, k) => [x[first + k], y[first + k]]).filter((point) => point.every(Number.isFinite));
    if (points.length) chart.line(points, `curve ${colour} ${STROKES[mode] ?? "slipping"} ${style}`);
  }
}

// The meaning of the line styles in a figure.
function strokesMean({ film }) {
  const modes = film.phases.map((phase) => overall(phase.contacts));
  const slips = film.contacts.length > 1 ? "Dashed: all feet on the ground slip. " : "Dashed: the foot slips. ";
  return (modes.includes("slip") ? slips : "") + (modes.includes("flight") ? "Dotted, thin: flight. " : "");
}

function positionAxis(film, names = []) {
  return film.lengths || names.includes("y") ? "angle [rad], length [m]" : "angle [rad]";
}

// Points before and after every jump within a step, as where a stop locks.
function leaps({ film }, x, y) {
  const range = ([low, high]) => LEAP * (high - low);
  const ends = film.phases.slice(1).map((phase, k) => [film.phases[k].last, phase.first, film.phases[k].step === phase.step]);
  return ends.filter(([before, after, within]) => within && (Math.abs(x[after] - x[before]) > range(extent(x)) || Math.abs(y[after] - y[before]) > range(extent(y))));
}

function portrait(host, moving, fellows, labels) {
  const { film } = moving;
  const { shape } = film;
  const options = { title: `Phase portrait of ${new Intl.ListFormat("en-GB").format(shape.map((name) => labels.symbols[name]))}`, x: positionAxis(film), y: film.lengths ? "rate [rad/s, m/s]" : "rate [rad/s]" };
  const all = (name) => fellows.flatMap((fellow) => [...(fellow[name] ?? [])]);
  options.xRange = extent(shape.flatMap(all));
  options.yRange = extent(shape.flatMap((name) => all(`d${name}`)));
  new Chart(host, options, (chart) => {
    shape.forEach((name, n) => {
      const [x, y, colour] = [moving[name], moving[`d${name}`], COLOURS[n % COLOURS.length]];
      const ends = stepEnds(moving.film);
      ends.forEach(([first, last], step) => {
        const [next] = ends[(step + 1) % ends.length];
        chart.line([[x[last], y[last]], [x[last], y[next]], [x[next], y[next]]], `jump ${colour}`);
        chart.dot(x[first], y[first], `dot ${colour}`);
      });
      for (const [before, after] of leaps(moving, x, y)) chart.line([[x[before], y[before]], [x[after], y[after]]], `jump ${colour}`);
      stroke(chart, moving, x, y, colour);
    });
  });
  const locks = shape.some((name) => leaps(moving, moving[name], moving[`d${name}`]).length);
  const dotted = film.cycle_end === "end of cycle" ? [] : [`the ${film.cycle_end}`];
  if (locks) dotted.push(film.contacts.length > 1 ? "an impact within the cycle" : "a stop that locks");
  legend(host, shape.map((name, n) => [COLOURS[n % COLOURS.length], labels.symbols[name]]), `${strokesMean(moving)}${dotted.length ? `Dotted: ${dotted.join(", or ")}. ` : ""}Dot: ${film.cycle_start}.`);
}

// Force ratios of all contacts; there is none while a contact carries nothing, or an undetermined share.
function ratios(moving) {
  return moving.film.contacts.map((contact, n) => {
    const [f_t, f_n] = [moving[`f_t${n}`], moving[`f_n${n}`]];
    return masked(moving.film, f_t.map((force, k) => (f_n[k] > CARRIES * moving.film.weight ? force / f_n[k] : NaN)), n);
  });
}

// Legend entries of the contacts that touch the ground; of an only contact, the stance foot.
function contactKey({ contacts, phases }) {
  if (contacts.length === 1) return [["first", "stance foot"]];
  const key = contacts.map(({ name }, n) => [COLOURS[n % COLOURS.length], name.replaceAll("_", " ")]);
  return key.filter((entry, n) => phases.some((phase) => phase.contacts[n]));
}

// Values while a contact touches the ground and its share of the force is determined, NaN elsewhere.
function masked({ phases }, values, n) {
  const kept = values.map(() => NaN);
  for (const { contacts, undetermined, first, last } of phases) if (contacts[n] && !undetermined[n]) for (let k = first; k <= last; k += 1) kept[k] = values[k];
  return kept;
}

function longest(fellows) {
  return Math.max(...fellows.map((fellow) => fellow.film.period));
}

function forceRatio(host, moving, fellows) {
  const { film } = moving;
  const highest = Math.max(...extent(fellows.flatMap((fellow) => [...ratios(fellow).flat(), ...fellow.film.impulse_ratios])).map(Math.abs));
  const friction = Math.max(...film.contacts.map((contact) => contact.friction));
  const reach = friction < 1.6 * highest ? Math.max(highest, 1.12 * friction) : highest;
  const options = { title: "Force ratio fₜ / fₙ", x: film.time_label, y: "force ratio σ", xRange: [0, longest(fellows)], yRange: [-reach, reach] };
  new Chart(host, options, (chart) => {
    chart.band(friction, Infinity, "beyond");
    chart.band(-Infinity, -friction, "beyond");
    ratios(moving).forEach((ratio, n) => stroke(chart, moving, moving.t, ratio, COLOURS[n % COLOURS.length], n, "on-edge"));
    stepEnds(film).forEach(([, last], step) => {
      if (Number.isFinite(film.impulse_ratios[step])) chart.cross(moving.t[last], film.impulse_ratios[step], "curve second");
    });
  });
  const cone = `Shaded: beyond the friction cone ±μ = ±${Number(friction.toPrecision(4))}.`;
  const cross = film.impulse_ratios.some(Number.isFinite) ? [["second", "impulse ratio that a sticking impact needs (cross)"]] : [];
  const slips = film.phases.some(({ mode }) => !(mode in STROKES)) ? "Thick, dashed: the foot slips. " : "";
  legend(host, [...contactKey(film), ...cross], slips + (friction < reach * 1.05 ? cone : `The cone ±${friction} is wider than the picture.`));
}

function normalForce(host, moving, fellows) {
  const { film } = moving;
  if (film.contacts.length === 1 && !fellows.some((fellow) => fellow.film.phases.some(({ mode }) => mode === "flight"))) return;
  const loads = (fellow) => fellow.film.contacts.map((contact, n) => fellow[`f_n${n}`].map((force) => force / fellow.film.weight));
  const options = { title: "Normal force fₙ over the weight", x: moving.film.time_label, y: "fₙ / (m g)", xRange: [0, longest(fellows)], yRange: extent(fellows.flatMap((fellow) => loads(fellow).flat())) };
  new Chart(host, options, (chart) => loads(moving).forEach((load, n) => stroke(chart, moving, moving.t, film.contacts.length > 1 ? masked(film, load, n) : load, COLOURS[n % COLOURS.length], n)));
  if (film.contacts.length > 1) legend(host, contactKey(film));
}

function slip(host, moving, fellows) {
  const range = extent(fellows.flatMap((fellow) => fellow.slipped.flatMap((x) => [...x])));
  if (range.every((value) => Math.abs(value) < 0.05)) return;
  const options = { title: moving.slipped.length > 1 ? "Slip of each contact" : "Slip of the stance foot", x: moving.film.time_label, y: "x [mm]", xRange: [0, longest(fellows)], yRange: range };
  new Chart(host, options, (chart) => moving.slipped.forEach((x, n) => stroke(chart, moving, moving.t, x, COLOURS[n % COLOURS.length], n)));
  if (moving.slipped.length > 1) legend(host, contactKey(moving.film));
}

function torques(host, moving, fellows) {
  const { actuators } = moving.film;
  const torque = actuators.map((name) => moving[`torque ${name}`]);
  const range = extent(fellows.flatMap((fellow) => fellow.film.actuators.flatMap((name) => [...fellow[`torque ${name}`]])));
  if (!range.some((value) => value !== 0 && Number.isFinite(value))) return;
  const options = { title: "Motors", x: moving.film.time_label, y: moving.film.motor_label, xRange: [0, longest(fellows)], yRange: range };
  new Chart(host, options, (chart) => torque.forEach((column, n) => stroke(chart, moving, moving.t, column, COLOURS[n])));
  legend(host, actuators.map((name, n) => [COLOURS[n], name.replaceAll("_", " ")]), strokesMean(moving));
}

function multiplierPlane(host, gait) {
  const largest = Math.max(...gait.multipliers.flat().map(Math.abs));
  const reach = Math.min(REACH, Math.max(1.15, 1.1 * largest));
  const height = matchMedia("(max-width: 50rem)").matches ? 200 : 250; // with the list below, the figure is as high as the others
  const options = { title: "Floquet multipliers", x: "real part", y: "imaginary part", xRange: [-reach, reach], yRange: [-reach, reach], height, square: true };
  new Chart(host, options, (chart) => {
    const turn = Array.from({ length: 121 }, (_, k) => (2 * Math.PI * k) / 120);
    chart.line(turn.map((angle) => [Math.cos(angle), Math.sin(angle)]), "axis");
    const beyond = new Map(); // points at the edge with the sizes of their multipliers
    for (const [re, im] of gait.multipliers) {
      const size = Math.max(Math.abs(re), Math.abs(im)) / reach;
      const [x, y] = size > 1 ? [re / size, im / size] : [re, im];
      chart.dot(x, y, `dot ${Math.hypot(re, im) < 1 ? "first" : "second"}`, 5);
      const edge = `${chart.px(x).toFixed(0)} ${chart.py(y).toFixed(0)}`;
      if (size > 1) beyond.set(edge, [...(beyond.get(edge) ?? []), shown(Number(Math.hypot(re, im).toPrecision(3)))]);
    }
    for (const [edge, sizes] of beyond) {
      const [x, y] = edge.split(" ").map(Number);
      chart.text(x + (x > chart.px(0) ? 6 : -6), y - 9, sizes.join(", "), x > chart.px(0) ? "end" : "start");
    }
  });
  legend(host, [["first", "inside the unit circle"], ["second", "outside: unstable"]]);
  host.lastElementChild.append(multiplierList(gait));
}

// Table of the multipliers with their moduli; one line per conjugate pair.
function multiplierList({ multipliers }) {
  const body = html("tbody");
  const cells = (tag, texts) => texts.map((text) => html(tag, tag === "th" ? { scope: "col" } : { class: "number" }, text));
  const paired = (re, im) => im !== 0 && multipliers.some(([a, b]) => a === re && b === -im);
  for (const [re, im] of multipliers.filter(([re, im]) => im >= 0 || !paired(re, im)))
    body.append(html("tr", {}, ...cells("td", [shown(re), `${paired(re, im) ? "±" : ""}${shown(im)}`, shown(Math.hypot(re, im))])));
  return html("table", { class: "multipliers", "aria-label": "Floquet multipliers" }, html("thead", {}, html("tr", {}, ...cells("th", ["re λ", "im λ", "|λ|"]))), body);
}

function comparison(host, { nodes, lines }, film, labels) {
  const solved = unpack(nodes);
  const walked = lines.map((line) => ({ mode: line.mode, ...unpack(line) }));
  const names = Object.keys(solved).filter((name) => name !== "t");
  const options = { title: "Simulation and NLP", x: film.time_label, y: positionAxis(film, names), xRange: [0, film.period] };
  options.yRange = extent(names.flatMap((name) => walked.flatMap((arc) => [...arc[name]])));
  new Chart(host, options, (chart) =>
    names.forEach((name, n) => {
      const colour = COLOURS[n % COLOURS.length];
      for (const arc of walked) chart.line(pairs(arc.t, arc[name]), `curve ${colour} ${STROKES[arc.mode] ?? "slipping"}`);
      pairs(solved.t, solved[name]).forEach(([t, angle]) => chart.dot(t, angle, `ring ${colour}`, 3.5));
    }),
  );
  legend(host, names.map((name, n) => [COLOURS[n % COLOURS.length], labels.symbols[name]]), "Lines: simulation, which finds its modes. Circles: NLP.");
}

function comparisonDifference(host, { gaps }, film) {
  const curves = gaps.map(unpack);
  const options = { title: "Largest difference of the states", x: film.time_label, y: "|difference|", xRange: [0, film.period] };
  options.yRange = extent(curves.flatMap((gap) => [...gap.difference]));
  options.yTick = (power) => (Number.isInteger(power) ? `1e${power}` : "");
  new Chart(host, options, (chart) => curves.forEach((gap) => chart.line(pairs(gap.t, gap.difference), "curve first")));
}

function pairs(x, y) {
  return Array.from(x, (value, k) => [value, y[k]]);
}

function legend(host, entries, note = "") {
  const key = html("p", { class: "key" });
  for (const [colour, label] of entries) key.append(html("span", {}, html("span", { class: `swatch ${colour}` }), ` ${label}`));
  if (note) key.append(html("span", {}, note));
  host.lastElementChild.append(key);
}
