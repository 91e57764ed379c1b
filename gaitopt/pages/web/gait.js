// One gait: what it is, how it moves, its figures.

function radius(gait) {
  return Math.max(0, ...gait.multipliers.map(([re, im]) => Math.hypot(re, im)));
}

function badge(gait) {
  const stable = radius(gait) < 1;
  return html("span", { class: `badge ${stable ? "good" : "bad"}` }, stable ? "stable" : "unstable");
}

function sequence(film, impact) {
  const merged = film.phases.map(({ mode }) => mode).filter((mode, k, all) => mode !== all[k - 1]);
  return `${merged.map((mode) => MODE_WORDS[mode]).join(", ")}; impact: ${MODE_WORDS[impact]}`;
}

class GaitPanel {
  // gaits: all that stand side by side, this one among them
  constructor(host, gait, gaits, labels, heading, settings) {
    host.replaceChildren();
    const { film } = gait;
    const check = { true: "verified by simulation", false: "NOT verified", null: "" }[gait.passed];
    host.append(html("h2", { "aria-live": "polite" }, heading), html("p", {}, badge(gait), ` ${sequence(film, gait.impact)}`, html("span", { class: "soft" }, check && ` · ${check}`)));
    const stage = html("section", { class: "stage", "aria-label": "animation" });
    const charts = html("section", { class: "charts", "aria-label": "figures" });
    this.aside = html("div", { class: "scroll" });
    host.append(html("div", { class: "overview" }, stage, this.aside), charts);
    this.player = new Player(stage, film, settings);
    const moving = motion(film);
    const fellows = gaits.map((other) => (other === gait ? moving : motion(other.film)));
    const draw = (paint, ...what) => {
      const cell = html("div");
      paint(cell, ...what);
      if (cell.childElementCount) charts.append(cell);
    };
    draw(portrait, moving, fellows, labels);
    draw(forceRatio, moving, fellows);
    draw(slip, moving, fellows);
    draw(torques, moving, fellows);
    draw(multiplierPlane, gait, gaits);
    if (gait.roads) draw(roads, gait.roads, film, labels);
  }
}

// Scalars, state after impact and freed parameters of gaits in columns; of two also their difference.
function numbersTable(host, gaits, labels) {
  const body = html("tbody");
  const names = gaits.map((gait) => gait.film.name);
  const head = ["", "unit", ...(gaits.length > 1 ? names : ["value"]), ...(gaits.length === 2 ? ["difference"] : [])];
  const row = (words, unit, values) => {
    if (values.every((value) => value === undefined)) return;
    const cells = values.map(shown);
    if (values.length === 2) cells.push(values.every((v) => typeof v === "number") ? shown(values[1] - values[0]) : "");
    body.append(html("tr", {}, html("th", { scope: "row" }, words), html("td", {}, unit), ...cells.map((cell) => html("td", { class: "number" }, cell))));
  };
  for (const [key, { words, unit }] of Object.entries(labels.scalars)) row(words, unit, gaits.map((gait) => gait.scalars[key]));
  const states = [...new Set(gaits.flatMap((gait) => Object.keys(gait.state)))];
  for (const name of states.filter((name) => name !== "x")) {
    const unit = (name === "dx" ? "m" : "rad") + (name.startsWith("d") ? "/s" : "");
    row(`${labels.symbols[name] ?? name} after impact`, unit, gaits.map((gait) => gait.state[name]));
  }
  const freed = [...new Set(gaits.flatMap((gait) => Object.keys(gait.parameters)))];
  for (const key of freed) row(`${key} (found)`, "", gaits.map((gait) => gait.parameters[key]));
  const titles = head.map((words) => html("th", { scope: "col" }, words));
  host.replaceChildren(html("table", {}, html("thead", {}, html("tr", {}, ...titles)), body));
}

function shown(value) {
  if (typeof value !== "number") return "–";
  return String(Math.abs(value) < 1e-12 ? 0 : Number(value.toPrecision(6))).replace("-", "−");
}
