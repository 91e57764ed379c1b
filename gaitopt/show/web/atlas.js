// The map of an atlas: regions over two parameters; a click, arrow keys or a button select a gait.

const MAP_HEIGHT = 440;
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const ASIDE = 2; // gaits that lie farther aside than this multiple of their distance ahead are not in this direction

class AtlasMap {
  constructor(host, data, choose) {
    Object.assign(this, { ...data, choose, sheet: 0 });
    this.diagram = html("div", { class: "diagram map" });
    this.tip = html("div", { class: "tip", hidden: "" });
    host.append(this.sheetButtons(), this.diagram, this.regionTable(), this.pointList());
    this.draw();
    this.select(this.gaits.findIndex(({ sheet }) => sheet === 0));
  }

  draw() {
    const [x, y] = this.axes;
    const options = { title: `Gaits over ${x.name} and ${y.name}`, x: axisOf(x), y: axisOf(y), xRange: x.range, yRange: y.range, height: MAP_HEIGHT, padding: 0 };
    this.diagram.replaceChildren();
    this.marker = undefined; // until the chart is painted
    this.chart = new Chart(this.diagram, options, (chart) => this.paint(chart));
    const drawn = this.curves.filter(({ sheet }) => sheet === this.sheet);
    legend(this.diagram, [], "Hatched: unstable. Click a place, or move with the arrow keys.");
    for (const [type, label] of new Map(drawn.map(({ type, label }) => [type, label]))) {
      const sample = html("span", {});
      const picture = svg(sample, "svg", { width: 24, height: 10, "aria-hidden": "true" });
      svg(picture, "path", { class: `curve edge ${type}`, d: "M0 5H24" });
      sample.append(` ${label}`);
      this.diagram.lastElementChild.lastElementChild.append(sample);
    }
    this.chart.box.append(this.tip);
  }

  paint(chart) {
    const pattern = svg(svg(chart.svg, "defs"), "pattern", { id: "hatch", width: 6, height: 6, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" });
    svg(pattern, "line", { class: "hatch", x1: 0, x2: 0, y1: 0, y2: 6 });
    const outline = (points) => `M${points.map(([x, y]) => `${chart.px(x).toFixed(1)} ${chart.py(y).toFixed(1)}`).join("L")}Z`;
    this.areas = this.regions.map(({ sheet, colour, unstable, outlines }) => {
      if (sheet !== this.sheet && sheet >= 0) return undefined;
      const d = outlines.map(outline).join("");
      const area = svg(chart.svg, "path", { class: `region ${colour}`, d });
      if (unstable) svg(chart.svg, "path", { class: "unstable-area", d, fill: "url(#hatch)" });
      return area;
    });
    for (const { sheet, type, points } of this.curves) if (sheet === this.sheet) chart.line(points, `curve edge ${type}`);
    const marks = this.points.filter(({ sheet }) => sheet === this.sheet).map(({ name, values: [x, y] }) => {
      svg(chart.dot(x, y, "special", 4), "title").textContent = name;
      return [name, chart.px(x), chart.py(y)];
    });
    writeBeside(chart, marks);
    this.marker = svg(chart.svg, "circle", { class: "chosen", r: 7 });
    this.mark();
    set(chart.svg, { tabindex: 0 });
    chart.svg.addEventListener("pointermove", (event) => this.hover(event));
    chart.svg.addEventListener("pointerleave", () => (this.tip.hidden = true));
    chart.svg.addEventListener("click", (event) => this.select(this.nearest(event)));
    chart.svg.addEventListener("keydown", (event) => {
      if (!(event.key in ARROWS)) return;
      event.preventDefault();
      this.select(this.beside(ARROWS[event.key]));
    });
  }

  at([x, y]) {
    return [this.chart.px(x), this.chart.py(y)];
  }

  pointer(event) {
    const frame = this.chart.svg.getBoundingClientRect();
    return [event.clientX - frame.left, event.clientY - frame.top];
  }

  // Number of the region under the pointer, or -1.
  regionAt([x, y]) {
    return this.areas.findIndex((area) => area?.isPointInFill(new DOMPoint(x, y)));
  }

  // Index of the gait of the region under the pointer that is nearest to it, or -1.
  nearest(event) {
    const [a, b] = this.pointer(event);
    const region = this.regionAt([a, b]);
    return this.closest((gait) => {
      const [x, y] = this.at(gait.values);
      return gait.region === region ? Math.hypot(x - a, y - b) : Infinity;
    });
  }

  // Index of the next gait in a direction, or -1.
  beside([right, down]) {
    const [a, b] = this.at(this.gaits[this.chosen].values);
    return this.closest(({ sheet, values }) => {
      const [x, y] = this.at(values);
      const ahead = right * (x - a) + down * (y - b);
      const aside = Math.abs(down * (x - a) + right * (y - b));
      return sheet === this.sheet && ahead > 1 && aside < ASIDE * ahead ? ahead + aside : Infinity;
    });
  }

  // Index of the gait with the smallest distance, or -1.
  closest(distance) {
    const distances = this.gaits.map(distance);
    const smallest = Math.min(...distances);
    return smallest < Infinity ? distances.indexOf(smallest) : -1;
  }

  hover(event) {
    const [x, y] = this.pointer(event);
    const region = this.regions[this.regionAt([x, y])];
    this.tip.hidden = !region;
    if (!region) return;
    this.tip.textContent = this.describe(region);
    this.tip.style.left = `${Math.min(x + 12, this.chart.width - 190)}px`;
    this.tip.style.top = `${y + 14}px`;
  }

  describe({ modes, unstable }) {
    return unstable === null ? modes : `${modes}; ${unstable ? "unstable" : "stable"}`;
  }

  // Select a gait, on its sheet; nothing happens where there is none.
  select(index) {
    if (index < 0) return;
    this.chosen = index;
    const { sheet, values } = this.gaits[index];
    if (sheet !== this.sheet) this.turnTo(sheet);
    this.mark();
    this.choose(this.gaits[index], this.axes.map((axis, k) => `${axis.name} = ${amount(values[k], axis)}`).join(", "));
  }

  mark() {
    if (!this.marker || this.chosen === undefined) return;
    const { sheet, values } = this.gaits[this.chosen];
    const [cx, cy] = this.at(values);
    this.marker.style.display = sheet === this.sheet ? "" : "none";
    set(this.marker, { cx, cy });
  }

  turnTo(sheet) {
    this.sheet = sheet;
    for (const [k, button] of [...this.buttons].entries()) button.setAttribute("aria-pressed", String(k === sheet));
    this.draw();
  }

  // One button per sheet of a family that folds over itself.
  sheetButtons() {
    const count = 1 + Math.max(0, ...this.regions.map(({ sheet }) => sheet));
    this.buttons = Array.from({ length: count > 1 ? count : 0 }, (_, k) => {
      const button = html("button", { type: "button", "aria-pressed": String(k === 0) }, `sheet ${k + 1}`);
      button.addEventListener("click", () => {
        this.turnTo(k);
        this.select(this.gaits.findIndex(({ sheet }) => sheet === k));
      });
      return button;
    });
    return html("p", { class: "buttons" }, ...this.buttons);
  }

  regionTable() {
    const folded = this.buttons.length > 0;
    const rows = this.regions.map((region, k) => {
      const { modes, unstable, sheet, colour, fraction } = region;
      const first = this.gaits.findIndex((gait) => gait.region === k);
      const name = first < 0 ? modes : html("button", { type: "button" }, modes);
      if (first >= 0) name.addEventListener("click", () => this.select(first));
      const stability = unstable === null ? "" : unstable ? "unstable" : "stable";
      const cells = [html("span", { class: `swatch region ${colour}` }), name, stability, ...(folded ? [sheet < 0 ? "" : String(sheet + 1)] : []), `${(100 * fraction).toPrecision(3)}\u00a0%`];
      return html("tr", {}, ...cells.map((cell) => html("td", {}, cell)));
    });
    const head = ["", "mode sequence", "", ...(folded ? ["sheet"] : []), "area"].map((heading) => html("th", { scope: "col" }, heading));
    const table = html("table", { class: "sequences" }, html("thead", {}, html("tr", {}, ...head)), html("tbody", {}, ...rows));
    return html("div", { class: "scroll", tabindex: 0, role: "group", "aria-label": "regions" }, table);
  }

  pointList() {
    const list = html("ul", { class: "specials" });
    for (const { name, values, within } of this.points) {
      const where = this.axes.map((axis, k) => `${axis.name} = ${amount(values[k], axis)}`).join(", ");
      list.append(html("li", {}, `${name} at ${where}${within ? " (not located)" : ""}`));
    }
    return list;
  }
}
