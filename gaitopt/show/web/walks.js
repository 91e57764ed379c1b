// Walks of one walker, of which one is chosen and played: by a button each, or by their start in a plane of two states.

class Walks {
  constructor(choice, stage, data) {
    Object.assign(this, { stage, ...data });
    this.said = html("p", { "aria-live": "polite" });
    if (this.plane) this.drawPlane(choice);
    else this.addButtons(choice);
    choice.append(this.said);
    this.select(this.first);
  }

  addButtons(choice) {
    this.buttons = this.walks.map(({ title }, k) => {
      const button = html("button", { type: "button", "aria-pressed": "false" }, title);
      button.addEventListener("click", () => this.select(k, true));
      return button;
    });
    choice.append(html("div", { class: "buttons" }, ...this.buttons));
  }

  // A cell for every start; those from which the walk goes on are coloured.
  drawPlane(choice) {
    const { title, x, y, size, gait } = this.plane;
    const starts = this.walks.map(({ start }) => start);
    const [xRange, yRange] = [0, 1].map((k) => extent([...starts, gait].map((start) => start[k])));
    const host = html("div", { class: "diagram" });
    choice.append(host);
    this.chart = new Chart(host, { title, x, y, xRange, yRange, height: 360 }, (chart) => {
      const [wide, high] = [chart.px(size[0]) - chart.px(0), chart.py(0) - chart.py(size[1])];
      const cell = (start, style) => svg(chart.svg, "rect", { class: style, x: chart.px(start[0]) - wide / 2, y: chart.py(start[1]) - high / 2, width: wide, height: high });
      this.walks.forEach(({ start, ending }) => cell(start, `cell ${ending === "completed" ? "walks" : ending === "fall" ? "falls" : "beyond"}`));
      chart.cross(...gait, "curve second");
      this.marker = cell(this.walks[this.chosen ?? this.first].start, "chosen");
      chart.svg.addEventListener("click", (event) => this.select(this.nearest(event), true));
    });
    const endings = [["walks", "walks on"], ["falls", "falls"], ["beyond", "ends otherwise"]];
    const key = endings.map(([style, label]) => html("span", {}, html("span", { class: `swatch cell ${style}` }), ` ${label}`));
    host.append(html("p", { class: "key" }, ...key, html("span", {}, "Cross: the gait.")));
  }

  nearest(event) {
    const frame = this.chart.svg.getBoundingClientRect();
    const distances = this.walks.map(({ start }) => Math.hypot(this.chart.px(start[0]) - (event.clientX - frame.left), this.chart.py(start[1]) - (event.clientY - frame.top)));
    return distances.indexOf(Math.min(...distances));
  }

  select(index, play = !STILL.matches) {
    this.chosen = index;
    const { film, title, message } = this.walks[index];
    this.buttons?.forEach((button, k) => button.setAttribute("aria-pressed", String(k === index)));
    if (this.chart?.svg) this.chart.redraw();
    this.said.textContent = `${title}: ${message}`;
    const settings = { speed: this.player?.settings.speed ?? FIRST_SPEED, playing: play };
    this.player?.play(false);
    this.stage.replaceChildren();
    this.player = new Player(this.stage, { ...this.common, ...film }, settings);
  }
}
