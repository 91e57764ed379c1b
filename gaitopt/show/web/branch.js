// The diagram of a branch: any scalar versus the parameter; click, slider or arrow keys select a gait.

const SPECIAL_NAMES = {
  fold: "fold", branch_point: "branches cross", period_doubling: "period doubling", neimark_sacker: "Neimark–Sacker", mode_change: "other phases begin",
  impact_change: "other impact begins", lift_off: "foot lifts off", painleve: "Painlevé paradox", end: "branch ends",
  vanishing: "gait vanishes",
};
const LOG = 10; // multipliers beyond this go on a log axis
const SMALLEST = 1e-3; // height of a multiplier of zero on that axis
const BELOW = 0.05; // more room below the lowest mark, for its value, relative to the range
const NEAR = 40; // largest distance of the pointer from a gait that it selects [pixels]

// Outlines around (0, 0) of unit size, one for every type of special point.
const MARKS = {
  fold: [[0.9, 0], [0.64, 0.64], [0, 0.9], [-0.64, 0.64], [-0.9, 0], [-0.64, -0.64], [0, -0.9], [0.64, -0.64]],
  branch_point: [[0, -1], [0.95, -0.3], [0.6, 0.8], [-0.6, 0.8], [-0.95, -0.3]],
  period_doubling: [[-0.8, -0.8], [0.8, -0.8], [0.8, 0.8], [-0.8, 0.8]],
  neimark_sacker: [[0, -1], [1, 0], [0, 1], [-1, 0]],
  mode_change: [[0, -1], [0.95, 0.8], [-0.95, 0.8]],
  impact_change: [[0, 1], [0.95, -0.8], [-0.95, -0.8]],
};
const CROSS = [[-0.8, -0.8], [0, -0.25], [0.8, -0.8], [0.25, 0], [0.8, 0.8], [0, 0.25], [-0.8, 0.8], [-0.25, 0]]; // where families end

function markPath(type, x, y, size) {
  return `M${(MARKS[type] ?? CROSS).map(([a, b]) => `${x + size * a} ${y + size * b}`).join("L")}Z`;
}

function specialKey(specials) {
  const key = html("p", { class: "key" });
  for (const type of new Set(specials.filter((special) => !special.bound).map((special) => special.type))) {
    const sample = html("span", {});
    const picture = svg(sample, "svg", { width: 16, height: 16, "aria-hidden": "true" });
    svg(picture, "path", { class: `special ${type}`, d: markPath(type, 8, 8, 6) });
    sample.append(` ${SPECIAL_NAMES[type] ?? type}`);
    key.append(sample);
  }
  return key;
}

class BranchDiagram {
  constructor(host, data, choose) {
    Object.assign(this, { ...data, choose, chosen: 0 });
    this.axis = axisOf(this.parameter);
    this.numbers = [...new Set(this.gaits.map((gait) => gait.branch))];
    const keys = Object.keys(this.scalars).filter((key) => this.gaits.some((gait) => typeof gait.scalars[key] === "number"));
    this.quantity = html("select", { id: "quantity" }, ...keys.map((key) => html("option", { value: key }, this.scalars[key].name)));
    this.quantity.value = keys.includes("spectral_radius") ? "spectral_radius" : keys[0];
    this.quantity.addEventListener("change", () => this.draw());
    this.slider = html("input", { type: "range", id: "point", min: 0, max: this.gaits.length - 1, step: 1, value: 0 });
    if (this.gaits.at(-1).value < this.gaits[0].value) this.slider.style.direction = "rtl"; // to the right the parameter grows
    this.slider.addEventListener("input", () => this.select(Number(this.slider.value)));
    this.diagram = html("div", { class: "diagram" });
    this.tip = html("div", { class: "tip", hidden: "" });
    const labels = [html("label", { for: "quantity" }, "Show "), this.quantity];
    const slide = html("div", { class: "slide" }, html("label", { for: "point" }, "Gait "), this.slider);
    host.append(html("p", {}, ...labels), this.diagram, slide, this.sequences(), this.specialList());
    this.draw();
    const wanted = Number.parseFloat(location.hash.slice(1)); // #0.13 selects the gait nearest to this value
    const away = this.gaits.map((gait) => Math.abs(gait.value - wanted));
    this.select(Number.isFinite(wanted) ? away.indexOf(Math.min(...away)) : 0);
  }

  // The mode sequence of a branch, that of its middle gait.
  sequenceOf(number) {
    const gaits = this.gaits.filter((gait) => gait.branch === number);
    const title = sequence(gaits[Math.floor(gaits.length / 2)].film);
    const same = this.numbers.filter((other) => other < number && this.named?.get(other)?.startsWith(title)).length;
    this.named = (this.named ?? new Map()).set(number, title);
    return same ? `${title} (branch ${number})` : title;
  }

  value(gait) {
    return gait.scalars[this.quantity.value];
  }

  // The scalar of a gait, or of every step of a cycle of several steps.
  values(gait) {
    return gait.steps?.[this.quantity.value] ?? [this.value(gait)];
  }

  // Height of a value on the vertical axis.
  height(value) {
    return this.log && typeof value === "number" ? Math.log10(Math.max(value, SMALLEST)) : value;
  }

  draw() {
    const key = this.quantity.value;
    const drawn = this.gaits.filter((gait) => typeof this.value(gait) === "number");
    this.log = key === "spectral_radius" && drawn.some((gait) => this.value(gait) > LOG);
    const level = key === "spectral_radius" ? [this.height(1)] : [];
    const options = { title: `${this.scalars[key].name} over ${this.parameter.name}`, x: this.axis, y: axisOf(this.scalars[key]), height: 340 };
    options.xRange = extent(this.gaits.map((gait) => gait.value));
    const [low, high] = extent([...drawn.flatMap((gait) => this.values(gait).map((value) => this.height(value))), ...level]);
    options.yRange = [low - BELOW * (high - low), high];
    if (this.log) options.yTick = (power) => shown(10 ** power);
    this.diagram.replaceChildren();
    this.chart = new Chart(this.diagram, options, (chart) => this.paint(chart, level));
    const entries = this.numbers.map((number, n) => [COLOURS[n % COLOURS.length], this.sequenceOf(number)]);
    legend(this.diagram, entries, "Thick: stable. Thin, dotted: unstable.");
    this.diagram.lastElementChild.append(specialKey(this.specials));
    this.chart.box.append(this.tip);
  }

  paint(chart, level) {
    level.forEach((y) => chart.level(y, "axis faint"));
    this.numbers.forEach((number, n) => this.paintBranch(chart, this.joined(number), COLOURS[n % COLOURS.length]));
    const marks = this.specials.flatMap((special) => this.paintSpecial(chart, special));
    writeBeside(chart, marks);
    this.marker = svg(chart.svg, "circle", { class: "chosen", r: 7 });
    this.mark();
    chart.svg.addEventListener("pointermove", (event) => this.hover(event));
    chart.svg.addEventListener("pointerleave", () => (this.tip.hidden = true));
    chart.svg.addEventListener("click", (event) => {
      const near = this.nearest(event);
      if (near >= 0) this.select(near);
    });
  }

  // Points of a branch, with those of its special points between them so that lines reach the markers. A special point
  // is as stable as the point before it: stability is lost at the marker.
  joined(number) {
    const known = this.gaits.filter((gait) => gait.branch === number && typeof this.value(gait) === "number");
    const line = known.map((gait) => ({ value: gait.value, heights: this.values(gait), stable: radius(gait) < 1, dot: true }));
    for (const { branch, next, type, value, scalars, steps } of line.length ? this.specials : []) {
      const [key, own] = [this.quantity.value, branch === number];
      if (typeof scalars[key] !== "number" || !(own || next?.includes(number)) || (key === "spectral_radius" && !(type in MARKS))) continue;
      const detours = line.slice(1).map((point, k) => Math.abs(value - line[k].value) + Math.abs(point.value - value) - Math.abs(point.value - line[k].value));
      const beyond = 2 * Math.abs(value - line.at(-1).value);
      const shortest = Math.min(...detours);
      const index = !own ? 0 : beyond <= shortest ? line.length : detours.indexOf(shortest) + 1;
      line.splice(index, 0, { value, heights: steps?.[key] ?? [scalars[key]], stable: line[Math.max(index - 1, 0)].stable });
    }
    return line;
  }

  paintBranch(chart, line, colour) {
    const points = ({ value, heights }) => heights.map((height) => [value, this.height(height)]);
    line.slice(1).forEach((point, k) => {
      const [before, after] = [points(line[k]), points(point)]; // where a doubled family begins, its origin has fewer steps
      for (let step = 0; step < Math.max(before.length, after.length); step += 1)
        chart.line([before[step % before.length], after[step % after.length]], `curve ${colour} ${point.stable ? "thick" : "unstable"}`);
    });
    for (const point of line.filter(({ dot }) => dot)) points(point).forEach(([x, y]) => chart.dot(x, y, `dot ${colour}`, 2));
  }

  // Mark a special point; returns its marks as [text, x, y], with the value that is written beside the first one.
  paintSpecial(chart, special) {
    const own = special.scalars[this.quantity.value];
    const nearest = this.gaits[this.nearestTo(special)];
    const values = typeof own === "number" ? (special.steps?.[this.quantity.value] ?? [own]) : nearest ? this.values(nearest) : [];
    if (typeof special.value !== "number" || special.bound) return [];
    const size = values.length > 1 ? 4 : 7;
    return values.filter((value) => typeof value === "number").map((y, k) => {
      const [a, b] = [chart.px(special.value), chart.py(this.height(y))];
      const mark = svg(chart.svg, "path", { class: `special ${special.type}`, d: markPath(special.type, a, b, size) });
      svg(mark, "title").textContent = SPECIAL_NAMES[special.type] ?? special.type;
      return [k === 0 && special.type in MARKS ? String(Number(special.value.toPrecision(4))) : "", a, b];
    });
  }

  // Index of the gait under the pointer, or -1.
  nearest(event) {
    const frame = this.chart.svg.getBoundingClientRect();
    const [x, y] = [event.clientX - frame.left, event.clientY - frame.top];
    const distances = this.gaits.map((gait) => {
      const heights = this.values(gait).map((value) => this.height(value)).filter((height) => typeof height === "number");
      return Math.min(Infinity, ...heights.map((height) => Math.hypot(this.chart.px(gait.value) - x, this.chart.py(height) - y)));
    });
    const best = distances.indexOf(Math.min(...distances));
    return distances[best] < NEAR ? best : -1;
  }

  nearestTo(special) {
    const distances = this.gaits.map((gait) => (gait.branch === special.branch ? Math.abs(gait.value - special.value) : Infinity));
    const best = distances.indexOf(Math.min(...distances));
    return distances[best] < Infinity ? best : -1;
  }

  hover(event) {
    const near = this.nearest(event);
    this.tip.hidden = near < 0;
    if (near < 0) return;
    const gait = this.gaits[near];
    const [x, y] = [this.chart.px(gait.value), this.chart.py(this.height(this.values(gait)[0]))];
    this.tip.textContent = this.describe(gait);
    this.tip.style.left = `${Math.min(x, this.chart.width - 190)}px`;
    this.tip.style.top = `${y + 14}px`;
  }

  describe(gait) {
    return `${this.parameter.name} ${amount(gait.value, this.parameter)}, ${this.scalars[this.quantity.value].name} ${shown(this.value(gait))}, ${sequence(gait.film)}`;
  }

  select(index) {
    this.chosen = index;
    this.slider.value = index;
    const gait = this.gaits[index];
    this.slider.setAttribute("aria-valuetext", this.describe(gait));
    this.mark();
    this.choose(gait, `Branch ${gait.branch}, ${this.parameter.name} = ${amount(gait.value, this.parameter)}`);
  }

  // Select a gait and bring it into view.
  show(index) {
    this.select(index);
    document.getElementById("gait").scrollIntoView({ behavior: scrolling(), block: "start" });
  }

  mark() {
    const gait = this.gaits[this.chosen];
    const height = this.height(this.values(gait)[0]);
    if (!this.marker) return;
    this.marker.style.display = typeof height === "number" ? "" : "none";
    if (typeof height === "number") set(this.marker, { cx: this.chart.px(gait.value), cy: this.chart.py(height) });
  }

  // Mode sequence of every branch as a bar, at its middle gait.
  sequences() {
    const rows = this.numbers.map((number) => {
      const gaits = this.gaits.filter((gait) => gait.branch === number);
      const middle = gaits[Math.floor(gaits.length / 2)];
      const [low, high] = extent(gaits.map((gait) => gait.value)).map(shown);
      const stable = gaits.filter((gait) => radius(gait) < 1).length;
      const cells = [String(number), modeBar(middle.film, 1), sequence(middle.film), `${low} to ${high}`, `${stable} of ${gaits.length}`];
      return html("tr", {}, ...cells.map((cell) => html("td", {}, cell)));
    });
    const head = ["branch", "one cycle", "mode sequence", this.axis, "stable gaits"].map((heading) => html("th", { scope: "col" }, heading));
    const table = html("table", { class: "sequences" }, html("thead", {}, html("tr", {}, ...head)), html("tbody", {}, ...rows));
    const modes = this.gaits.flatMap((gait) => gait.film.phases.map((phase) => phase.mode));
    return html("div", { class: "scroll", tabindex: 0, role: "group", "aria-label": "mode sequences" }, table, modeKey(modes));
  }

  specialList() {
    const list = html("ul", { class: "specials" });
    for (const special of this.specials) {
      const sentence = `${special.bound ? "the request ends" : SPECIAL_NAMES[special.type] ?? special.type} at ${amount(special.value, this.parameter)} (branch ${special.branch}${special.next?.length ? ` to ${special.next.join(", ")}` : ""}${special.status === "guess" ? ", only bracketed" : ""})`;
      const button = html("button", { type: "button" }, sentence);
      const nearest = this.nearestTo(special);
      button.disabled = nearest < 0;
      button.addEventListener("click", () => this.show(nearest));
      list.append(html("li", {}, button, special.reason && !special.bound ? ` ${special.reason}` : ""));
    }
    for (const cascade of this.cascades) list.append(html("li", {}, `Cascade: ${cascade}`));
    return list;
  }
}
