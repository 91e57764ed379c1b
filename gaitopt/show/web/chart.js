// A small chart: axes with round ticks, lines, points and bands; redrawn whenever its width changes.

const MARGIN = { left: 66, right: 12, top: 10, bottom: 42 };
const PADDING = 0.05; // margin on both sides of a range, relative to it
const LETTER = 7; // width of a letter beside a mark [pixels]

class Chart {
  // paint(chart) draws the contents; ranges are [low, high], wider by `padding`; square: the panel is
  constructor(host, { title, x, y, xRange, yRange, height = 250, square = false, padding = PADDING, yTick = String }, paint) {
    Object.assign(this, { x, y, xRange: padded(xRange, padding), yRange: padded(yRange, padding), height, square, yTick, paint });
    this.box = html("div", { class: "chart" });
    this.title = title;
    host.append(html("figure", {}, html("figcaption", {}, title), this.box));
    new ResizeObserver(() => {
      const width = this.box.clientWidth; // zero after the chart was removed from the page
      if (width > 0 && width !== this.room) this.redraw();
    }).observe(this.box);
  }

  redraw() {
    this.room = this.box.clientWidth;
    const side = this.height - MARGIN.top - MARGIN.bottom;
    this.width = this.square ? Math.min(this.room, side + MARGIN.left + MARGIN.right) : this.room;
    this.box.querySelector("svg")?.remove();
    this.svg = svg(this.box, "svg", { width: this.width, height: this.height, role: "img", "aria-label": this.title });
    this.axes();
    this.paint(this);
  }

  px(x) {
    const [low, high] = this.xRange;
    return MARGIN.left + ((x - low) / (high - low)) * (this.width - MARGIN.left - MARGIN.right);
  }

  py(y) {
    const [low, high] = this.yRange;
    return this.height - MARGIN.bottom - ((y - low) / (high - low)) * (this.height - MARGIN.top - MARGIN.bottom);
  }

  axes() {
    const [left, right, bottom, top] = [...this.xRange.map((x) => this.px(x)), ...this.yRange.map((y) => this.py(y))];
    for (const x of ticks(this.xRange, this.width / 90)) {
      svg(this.svg, "line", { class: "grid", x1: this.px(x), x2: this.px(x), y1: bottom, y2: top });
      this.text(this.px(x), bottom + 16, String(x), "middle");
    }
    for (const y of ticks(this.yRange, this.height / 50)) {
      svg(this.svg, "line", { class: "grid", x1: left, x2: right, y1: this.py(y), y2: this.py(y) });
      this.text(left - 6, this.py(y) + 4, this.yTick(y), "end");
    }
    svg(this.svg, "path", { class: "axis", d: `M${left} ${top}V${bottom}H${right}` });
    this.text((left + right) / 2, this.height - 8, this.x, "middle");
    const label = this.text(0, 0, this.y, "middle");
    label.setAttribute("transform", `translate(12 ${(top + bottom) / 2}) rotate(-90)`);
  }

  text(x, y, content, anchor) {
    const element = svg(this.svg, "text", { x, y, "text-anchor": anchor });
    element.textContent = content.replace("-", "−");
    return element;
  }

  line(points, style) {
    const path = points.map(([x, y]) => `${this.px(x).toFixed(1)} ${this.py(y).toFixed(1)}`).join("L");
    return svg(this.svg, "path", { class: style, d: `M${path}` });
  }

  dot(x, y, style, r = 4) {
    return svg(this.svg, "circle", { class: style, cx: this.px(x), cy: this.py(y), r });
  }

  cross(x, y, style) {
    const [a, b] = [this.px(x), this.py(y)];
    return svg(this.svg, "path", { class: style, d: `M${a - 5} ${b - 5}l10 10m0 -10l-10 10` });
  }

  level(y, style) {
    return this.line(this.xRange.map((x) => [x, y]), style);
  }

  band(low, high, style) {
    const [a, b] = [this.py(Math.min(high, this.yRange[1])), this.py(Math.max(low, this.yRange[0]))];
    if (b > a) svg(this.svg, "rect", { class: style, x: MARGIN.left, y: a, width: this.width - MARGIN.left - MARGIN.right, height: b - a });
  }
}

function extent(values) {
  return values.filter(Number.isFinite).reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, -Infinity]);
}

function padded([low, high], fraction) {
  const pad = high > low ? fraction * (high - low) : PADDING * Math.abs(high) || 1e-3;
  return [low - pad, high + pad];
}

// Write texts beside marks, each [text, x, y]: over no other mark or text, and over as little of the curves as possible.
// A text that has no room is left out.
function writeBeside(chart, marks) {
  const taken = marks.map(([, x, y]) => [x - 8, x + 8, y - 8, y + 8]);
  const curves = [...chart.svg.querySelectorAll("path.curve")].flatMap((path) => Array.from({ length: Math.ceil(path.getTotalLength() / 3) }, (_, k) => path.getPointAtLength(3 * k)));
  for (const [text, x, y] of marks.filter(([text]) => text)) {
    const width = LETTER * text.length;
    const options = [[1, -1], [-1, -1], [1, 1], [-1, 1]].map(([right, down]) => {
      const [a, b] = [x + 9 * right, y + (down > 0 ? 20 : -9)];
      const box = [Math.min(a, a + width * right), Math.max(a, a + width * right), b - 12, b + 1];
      const free = taken.every(([left, end, top, bottom]) => box[0] > end || box[1] < left || box[2] > bottom || box[3] < top);
      const covered = curves.filter((point) => point.x > box[0] && point.x < box[1] && point.y > box[2] && point.y < box[3]).length;
      return { a, b, box, right, covered, fits: free && box[0] >= 0 && box[1] <= chart.width && box[2] >= 0 && box[3] <= chart.py(chart.yRange[0]) };
    }).filter(({ fits }) => fits);
    if (!options.length) continue;
    const { a, b, box, right } = options.reduce((best, option) => (option.covered < best.covered ? option : best));
    taken.push(box);
    chart.text(a, b, text, right > 0 ? "start" : "end");
  }
}

function ticks([low, high], wanted) {
  const rough = (high - low) / Math.max(2, wanted);
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough);
  const first = Math.ceil(low / step);
  return Array.from({ length: Math.floor(high / step) - first + 1 }, (_, k) => Number(((first + k) * step).toPrecision(12)));
}
