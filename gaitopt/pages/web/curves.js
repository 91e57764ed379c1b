// The figures of one gait: portrait, force ratio, slip, torques, multipliers; dashed where the foot slips.
// `fellows` are all motions that stand side by side, this one among them: they share their axes.

const COLOURS = ["first", "second", "third"];

// Times, columns and phases of a film, unpacked once.
function motion(film) {
  const columns = unpack(film.frames);
  const t = new Float64Array(film.frames.rows);
  for (const { start, end, first, last } of film.phases)
    for (let k = first; k <= last; k += 1) t[k] = start + ((end - start) * (k - first)) / (last - first);
  return { film, t, ...columns };
}

// Draw y over x, phase by phase.
function stroke(chart, moving, x, y, colour) {
  for (const { mode, first, last } of moving.film.phases) {
    const points = Array.from({ length: last - first + 1 }, (_, k) => [x[first + k], y[first + k]]);
    chart.line(points, `curve ${colour} ${mode === "stick" ? "" : "slipping"}`);
  }
}

function portrait(host, moving, fellows, labels) {
  const { shape } = moving.film;
  const options = { title: `Phase portrait of ${shape.map((name) => labels.symbols[name]).join(" and ")}`, x: "angle [rad]", y: "rate [rad/s]" };
  const all = (name) => fellows.flatMap((fellow) => [...(fellow[name] ?? [])]);
  options.xRange = extent(shape.flatMap(all));
  options.yRange = extent(shape.flatMap((name) => all(`d${name}`)));
  new Chart(host, options, (chart) => {
    shape.forEach((name, n) => {
      const [x, y, colour] = [moving[name], moving[`d${name}`], COLOURS[n % COLOURS.length]];
      const last = x.length - 1;
      chart.line([[x[last], y[last]], [x[last], y[0]], [x[0], y[0]]], `jump ${colour}`);
      stroke(chart, moving, x, y, colour);
      chart.dot(x[0], y[0], `dot ${colour}`);
    });
  });
  legend(host, shape.map((name, n) => [COLOURS[n % COLOURS.length], labels.symbols[name]]), "Dashed: the foot slips. Dotted: the impact. Dot: just after it.");
}

function ratios({ f_t, f_n }) {
  return f_t.map((force, k) => force / f_n[k]);
}

function longest(fellows) {
  return Math.max(...fellows.map((fellow) => fellow.film.period));
}

function forceRatio(host, moving, fellows) {
  const { film } = moving;
  const ratio = ratios(moving);
  const highest = Math.max(...extent(fellows.flatMap((fellow) => [...ratios(fellow), fellow.film.impulse_ratio])).map(Math.abs));
  const reach = film.friction < 1.6 * highest ? Math.max(highest, 1.12 * film.friction) : highest;
  const options = { title: "Force ratio f_t / f_n", x: "time since impact [s]", y: "force ratio σ", xRange: [0, longest(fellows)], yRange: [-reach, reach] };
  new Chart(host, options, (chart) => {
    chart.band(film.friction, Infinity, "beyond");
    chart.band(-Infinity, -film.friction, "beyond");
    stroke(chart, moving, moving.t, ratio, "first");
    chart.cross(film.period, film.impulse_ratio, "curve second");
  });
  const cone = `Shaded: beyond the friction cone ±μ = ±${Number(film.friction.toPrecision(4))}.`;
  legend(host, [["first", "stance foot"], ["second", "impulse ratio that a sticking impact needs (cross)"]], film.friction < reach * 1.05 ? cone : `The cone ±${film.friction} is wider than the picture.`);
}

function slip(host, moving, fellows) {
  const x = moving.x0.map((metres) => 1000 * metres);
  const range = extent(fellows.flatMap((fellow) => [...fellow.x0])).map((metres) => 1000 * metres);
  if (range.every((value) => Math.abs(value) < 1e-3)) return;
  const options = { title: "Slip of the stance foot", x: "time since impact [s]", y: "x [mm]", xRange: [0, longest(fellows)], yRange: range };
  new Chart(host, options, (chart) => stroke(chart, moving, moving.t, x, "first"));
}

function torques(host, moving, fellows) {
  const { actuators } = moving.film;
  const torque = actuators.map((name) => moving[`torque ${name}`]);
  const range = extent(fellows.flatMap((fellow) => fellow.film.actuators.flatMap((name) => [...fellow[`torque ${name}`]])));
  if (!range.some((value) => value !== 0 && Number.isFinite(value))) return;
  const options = { title: "Torques", x: "time since impact [s]", y: "torque [N m]", xRange: [0, longest(fellows)], yRange: range };
  new Chart(host, options, (chart) => torque.forEach((column, n) => stroke(chart, moving, moving.t, column, COLOURS[n])));
  legend(host, actuators.map((name, n) => [COLOURS[n], name]));
}

function multiplierPlane(host, gait, gaits) {
  const reach = Math.max(1.1, ...gaits.flatMap((other) => other.multipliers.flat()).map((part) => 1.1 * Math.abs(part)));
  const options = { title: "Floquet multipliers", x: "real part", y: "imaginary part", xRange: [-reach, reach], yRange: [-reach, reach], square: true };
  new Chart(host, options, (chart) => {
    const turn = Array.from({ length: 121 }, (_, k) => (2 * Math.PI * k) / 120);
    chart.line(turn.map((angle) => [Math.cos(angle), Math.sin(angle)]), "axis");
    gait.multipliers.forEach(([re, im]) => chart.dot(re, im, `dot ${Math.hypot(re, im) < 1 ? "first" : "second"}`, 5));
  });
  legend(host, [["first", "inside the unit circle"], ["second", "outside: unstable"]]);
}

function roads(host, { nodes, lines, gaps }, film, labels) {
  const found = unpack(nodes);
  const walked = lines.map((line) => ({ mode: line.mode, ...unpack(line) }));
  const options = { title: "Two roads: simulation and NLP", x: "time since impact [s]", y: "angle [rad]", xRange: [0, film.period] };
  options.yRange = extent(film.shape.flatMap((name) => walked.flatMap((arc) => [...arc[name]])));
  new Chart(host, options, (chart) =>
    film.shape.forEach((name, n) => {
      const colour = COLOURS[n % COLOURS.length];
      for (const arc of walked) chart.line(pairs(arc.t, arc[name]), `curve ${colour} ${arc.mode === "stick" ? "" : "slipping"}`);
      pairs(found.t, found[name]).forEach(([t, angle]) => chart.dot(t, angle, `ring ${colour}`, 3.5));
    }),
  );
  legend(host, film.shape.map((name, n) => [COLOURS[n % COLOURS.length], labels.symbols[name]]), "Lines: simulation, which chooses its modes. Circles: NLP.");
  const curves = gaps.map(unpack);
  const difference = { ...options, title: "Largest difference of the states", y: "|difference|", height: 190 };
  difference.yRange = extent(curves.flatMap((gap) => [...gap.difference]));
  difference.yTick = (power) => (Number.isInteger(power) ? `1e${power}` : "");
  new Chart(host, difference, (chart) => curves.forEach((gap) => chart.line(pairs(gap.t, gap.difference), "curve first")));
}

function pairs(x, y) {
  return Array.from(x, (value, k) => [value, y[k]]);
}

function legend(host, entries, note = "") {
  const key = html("p", { class: "key" });
  for (const [colour, words] of entries) key.append(html("span", {}, html("span", { class: `swatch ${colour}` }), ` ${words}`));
  if (note) key.append(html("span", {}, note));
  host.lastElementChild.append(key);
}
