// One gait: its modes, the moving walker, its figures.

function radius(gait) {
  return Math.max(0, ...gait.multipliers.map(([re, im]) => Math.hypot(re, im)));
}

function badge(gait) {
  const stable = radius(gait) < 1;
  return html("span", { class: `badge ${stable ? "good" : "bad"}` }, stable ? "stable" : "unstable");
}

// The modes of every step and the impact that ends it.
function sequence(film) {
  const steps = Array.from({ length: film.steps }, (_, step) => film.phases.filter((phase) => phase.step === step).map(({ label }) => label));
  const titles = steps.map((modes, step) => `${modes.filter((mode, k) => mode !== modes[k - 1]).join(film.contacts.length > 1 ? " → " : ", ")}; ${film.cycle_end}: ${film.impacts[step]}`);
  return titles.length > 1 && new Set(titles).size === 1 ? `${titles.length} times ${titles[0]}` : titles.join(" | ");
}

class GaitPanel {
  // gaits: all gaits of the page, with this one
  constructor(host, gait, gaits, labels, heading, settings) {
    host.replaceChildren();
    const check = { true: "verified by simulation", false: "NOT verified", null: "" }[gait.passed];
    gait.film = gait.film.columns ? gait.film : unrolled(gait.film);
    const film = gait.film;
    if (heading) host.append(html("h2", { "aria-live": "polite" }, heading));
    host.append(html("p", {}, badge(gait), ` ${sequence(film)}`, html("span", { class: "soft" }, check && ` · ${check}`)));
    const stage = html("section", { class: "stage", "aria-label": "animation" });
    const charts = html("section", { class: "charts", tabindex: 0, "aria-label": "figures" });
    this.aside = html("div", { class: "scroll", tabindex: 0, role: "group", "aria-label": "numbers" });
    host.append(html("div", { class: "overview" }, stage, this.aside), charts);
    this.player = new Player(stage, film, settings);
    const moving = motion(film);
    const fellows = gaits.map((other) => (other === gait ? moving : motion(other.film.columns ? other.film : unrolled(other.film))));
    const draw = (paint, ...what) => {
      const cell = html("div", { class: paint.name });
      paint(cell, ...what);
      if (cell.childElementCount) charts.append(cell);
    };
    draw(portrait, moving, fellows, labels);
    draw(forceRatio, moving, fellows);
    draw(normalForce, moving, fellows);
    draw(slip, moving, fellows);
    draw(torques, moving, fellows);
    draw(multiplierPlane, gait, gaits);
    if (gait.comparison) draw(comparison, gait.comparison, film, labels), draw(comparisonDifference, gait.comparison, film);
    const visible = [...charts.children].filter((cell) => getComputedStyle(cell).display !== "none");
    // On a phone they lie side by side.
    charts.before(html("p", { class: "swipe" }, `${visible.length} figures: swipe →`));
  }
}

// Scalars, state after impact and freed parameters of gaits in columns, with the difference of two gaits.
function numbersTable(host, gaits, labels) {
  const body = html("tbody");
  const names = gaits.map((gait) => gait.film.name);
  const head = ["", "unit", ...(gaits.length > 1 ? names : ["value"]), ...(gaits.length === 2 ? ["difference"] : [])];
  const row = (name, unit, values) => {
    if (values.every((value) => value === undefined || value === null)) return;
    const cells = values.map(shown);
    if (values.length === 2) cells.push(values.every((v) => typeof v === "number") ? shown(values[1] - values[0]) : "");
    body.append(html("tr", {}, html("th", { scope: "row" }, name), html("td", {}, unit), ...cells.map((cell) => html("td", { class: "number" }, cell))));
  };
  const slips = gaits.some(({ film }) => film.phases.some(({ mode }) => !(mode in STROKES)));
  for (const [key, { name, unit }] of Object.entries(labels.scalars)) row(slips && key === "required_friction" ? labels.slipping : name, unit, gaits.map((gait) => gait.scalars[key]));
  const states = [...new Set(gaits.flatMap((gait) => Object.keys(gait.state)))];
  for (const name of states.filter((name) => name !== "x")) {
    row(`${labels.symbols[name] ?? name} ${gaits[0].film.cycle_start}`, labels.units[name], gaits.map((gait) => gait.state[name]));
  }
  const freed = [...new Set(gaits.flatMap((gait) => Object.keys(gait.parameters)))];
  for (const key of freed) row(`${labels.parameters[key].name} (free)`, labels.parameters[key].unit, gaits.map((gait) => gait.parameters[key]));
  const titles = head.map((heading) => html("th", { scope: "col" }, heading));
  host.replaceChildren(html("table", {}, html("thead", {}, html("tr", {}, ...titles)), body));
}

function shown(value) {
  if (typeof value !== "number") return "–";
  return String(Math.abs(value) < 1e-12 ? 0 : Number(value.toPrecision(6))).replace("-", "−");
}

// A value of a parameter with its unit.
function amount(value, { unit }) {
  return `${shown(value)}${unit === "°" || !unit ? unit : ` ${unit}`}`;
}

// The label of an axis.
function axisOf({ name, unit }) {
  return unit ? `${name} [${unit}]` : name;
}

// Buttons that bring one of several gaits into view where they do not fit side by side.
function tabs(gaits, side) {
  const buttons = gaits.map((gait, k) => {
    const button = html("button", { type: "button" }, gait.film.name);
    button.addEventListener("click", () => side.scrollTo({ left: side.children[k].offsetLeft - side.offsetLeft, behavior: scrolling() }));
    return button;
  });
  return html("nav", { class: "tabs", "aria-label": "gaits" }, ...buttons);
}

// A button that plays all walkers, and an overlay of the first two at the time of the first one.
function together(panels, gaits) {
  const section = html("section", { class: "together", "aria-label": "all gaits together" });
  const play = html("button", { type: "button", class: "play" });
  const say = () => (play.textContent = panels.some(({ player }) => player.playing) ? "Pause all" : "Play all");
  play.addEventListener("click", () => {
    const on = !panels.some(({ player }) => player.playing);
    for (const { player } of panels) player.seek(0), player.play(on);
    say();
  });
  for (const { player } of panels) player.button.addEventListener("click", say);
  say();
  const overlay = html("div", { class: "overlay", hidden: "" });
  const show = html("button", { type: "button", "aria-pressed": "false" }, `Overlay of ${gaits[0].film.name} and ${gaits[1].film.name}`);
  show.addEventListener("click", () => {
    const on = overlay.hidden;
    overlay.hidden = !on;
    show.setAttribute("aria-pressed", String(on));
    overlay.replaceChildren();
    if (!on) return;
    const layers = html("div", { class: "layers" });
    const walkers = gaits.slice(0, 2).map((gait) => new Walker(layers, gait.film));
    overlay.append(layers, html("p", { class: "soft" }, `The second walker is drawn pale. Both start ${gaits[0].film.cycle_start}; the picture follows each of them. Time and speed are those of ${gaits[0].film.name}.`));
    const tick = () => {
      if (overlay.hidden || !walkers[0].ground.isConnected) return;
      for (const walker of walkers) walker.draw(panels[0].player.time % walker.duration);
      requestAnimationFrame(tick);
    };
    tick();
  });
  section.append(html("div", { class: "controls" }, play, show), overlay);
  return section;
}
