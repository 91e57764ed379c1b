// The walker on its slope: legs, masses, contact force inside the friction cone, and the marks that slip leaves.
// World coordinates are metres with x downhill and y along the slope's normal; one group turns and scales them.

const VIEW = { width: 640, height: 360 };
const WALKER_SHARE = 0.66; // height of the walker relative to the view
const WIDTH_SHARE = 0.45; // largest distance of a point from the middle, relative to the width of the view
const GROUND_AT = 0.84;
const FORCE_PER_WEIGHT = 0.45; // length of the arrow of a force equal to the weight, in heights of the walker
const CONE = 0.6;
const TILE_DEPTH = 0.05; // of the tint of a tile, in heights of the walker
const FAINTEST = 0.15; // opacity of the tint of a tile with nearly nominal friction
const MARK_DEPTH = { slip_forward: 0.025, slip_backward: 0.06 }; // below the ground, in heights of the walker
const LENS = { left: 12, top: 12, width: 158, height: 132, ground: 0.68, weight: 78 }; // the magnifier; its arrow of the weight is so long

class Walker {
  constructor(host, film) {
    this.film = film.columns ? film : unrolled(film);
    this.repeats = film.repeats;
    this.frames = this.film.columns;
    this.count = Object.keys(this.frames).filter((name) => /^y\d+$/.test(name)).length;
    this.duration = film.period * this.repeats;
    this.height = this.tallest();
    this.scale = Math.min((WALKER_SHARE * VIEW.height) / this.height, (WIDTH_SHARE * VIEW.width) / this.reach());
    this.height = (WALKER_SHARE * VIEW.height) / this.scale; // of a low, long walker the height that would fit
    this.build(host);
    this.draw(0);
  }

  build(host) {
    const degrees = (this.film.slope * 180) / Math.PI;
    const tilt = Math.abs(degrees) < 0.005 ? "level ground" : `slope ${Number(degrees.toPrecision(3))}°`;
    this.caption = html("span");
    host.append(html("div", { class: "caption" }, this.caption, html("span", {}, tilt)));
    const picture = svg(host, "svg", { viewBox: `0 0 ${VIEW.width} ${VIEW.height}`, class: "walker", role: "img" });
    picture.setAttribute("aria-label", `moving picture of ${this.film.name}`);
    const transform = `translate(${VIEW.width / 2} ${GROUND_AT * VIEW.height}) rotate(${degrees})`;
    this.world = svg(svg(picture, "g", { transform }), "g");
    for (const [left, right, low, high, change] of this.film.tiles.filter((tile) => tile[4])) {
      const depth = TILE_DEPTH * this.height;
      const d = `M${left} ${low}L${right} ${high}V${high - depth}L${left} ${low - depth}Z`;
      svg(this.world, "path", { class: `tile ${change < 0 ? "icy" : "sticky"}`, d }).style.fillOpacity = Math.min(1, FAINTEST + Math.abs(change));
    }
    this.ground = svg(this.world, "path", { class: "ground" });
    this.marks = this.slips().map((slip) => ({ ...slip, line: svg(this.world, "line", { class: `mark ${slip.mode}` }) }));
    this.cones = this.film.contacts.map(() => svg(this.world, "path", { class: "cone" }));
    this.ties = this.film.ties.map(() => svg(this.world, "line", { class: "tie" }));
    this.legs = this.film.legs.map(() => svg(this.world, "line", { class: "leg" }));
    this.discs = this.film.discs.map(([, share]) => svg(this.world, "circle", { class: "disc", r: this.height * (0.012 + 0.035 * Math.sqrt(share)) }));
    this.forces = this.film.contacts.map(() => svg(this.world, "path", { class: "force" }));
    if (this.film.magnification) this.buildMagnifier(picture, degrees);
  }

  // The foot that slips, much larger: its trace on the ground, and the force in its cone.
  buildMagnifier(picture, degrees) {
    const { left, top, width, height, ground } = LENS;
    this.lens = svg(picture, "g", { class: "lens", transform: `translate(${left} ${top})` });
    svg(this.lens, "rect", { class: "glass", width, height, rx: 8 });
    const inside = svg(this.lens, "svg", { width, height });
    const turned = svg(inside, "g", { transform: `translate(${width / 2} ${ground * height}) rotate(${degrees})` });
    this.close = svg(turned, "g");
    const [scale, reach] = [this.scale * this.film.magnification, 2 * width];
    this.lensScale = scale;
    const gap = width / 8;
    svg(turned, "path", { class: "ground", d: `M${-reach} 0H${reach}` });
    this.hatch = svg(turned, "path", { class: "ground" });
    this.hatchGap = gap / scale;
    this.traces = this.marks.map(({ mode }) => svg(this.close, "line", { class: `mark ${mode}` }));
    this.closeLegs = this.film.legs.map(() => svg(this.close, "line", { class: "leg" }));
    this.lensCone = svg(turned, "path", { class: "cone" });
    this.foot = svg(turned, "circle", { class: "foot", r: 8 });
    this.lensForce = svg(turned, "path", { class: "force" });
    this.rim = svg(this.lens, "rect", { class: "rim", width, height, rx: 8 });
    const step = [0.5, 1, 2, 5, 10, 20, 50, 100, 200].find((mm) => mm * 1e-3 * scale > 18) ?? 500;
    const bar = step * 1e-3 * scale;
    svg(this.lens, "path", { class: "bar", d: `M${width - 10 - bar} ${height - 11}v4h${bar}v-4` });
    svg(this.lens, "text", { x: width - 16 - bar, y: height - 7, "text-anchor": "end" }).textContent = `${step} mm`;
    svg(this.lens, "text", { x: 8, y: height - 7 }).textContent = `×${this.film.magnification}`;
  }

  drawMagnifier(phase, points, offset, frame, step) {
    this.lens.classList.toggle("away", !phase.closeup);
    this.rim.setAttribute("class", "rim");
    if (!phase.closeup) return;
    const [n, middleInCycle] = phase.closeup;
    const [mode, middle, { mark }] = [phase.contacts[n], middleInCycle + offset, this.film.contacts[n]];
    const [friction, tilt] = this.under(phase, n);
    const base = this.film.tiles.length ? this.frames[`y${mark}`][phase.first] : 0;
    if (mode in MARK_DEPTH) this.rim.classList.add("glows", mode);
    this.close.setAttribute("transform", `scale(${this.lensScale} ${-this.lensScale}) translate(${-middle} ${-base})`);
    this.marks.forEach(({ line, mode: kind, point }, k) => {
      const trace = this.traces[k];
      trace.style.display = point === mark ? line.style.display : "none";
      if (trace.style.display === "none") return;
      const y = base + (kind === "slip_forward" ? -9 : -17) / this.lensScale;
      set(trace, { x1: line.getAttribute("x1"), x2: line.getAttribute("x2"), y1: y, y2: y });
    });
    this.join(this.closeLegs, this.film.legs, points, this.film.sides, step);
    const first = Math.ceil((middle - LENS.width / this.lensScale) / this.hatchGap);
    let path = "";
    for (let k = first; k < first + 17; k += 1) path += `M${(k * this.hatchGap - middle) * this.lensScale} 0l-7 7`;
    this.hatch.setAttribute("d", path);
    const x = (points[mark][0] - middle) * this.lensScale;
    const y = (base - points[mark][1]) * this.lensScale;
    set(this.foot, { cx: x, cy: y, class: `foot ${mode}` });
    const carries = !phase.undetermined[n];
    for (const shape of [this.lensCone, this.lensForce]) shape.style.display = carries ? "" : "none";
    if (!carries) return;
    const unit = LENS.weight / this.film.weight;
    const tip = [x + unit * this.at(`f_t${n}`, frame), y - unit * this.at(`f_n${n}`, frame)];
    const tall = Math.min(1, 0.5 / friction) * 0.9 * LENS.weight;
    this.lensCone.setAttribute("d", `M${x + friction * tall} ${y - tall}L${x} ${y}L${x - friction * tall} ${y - tall}`);
    this.lensCone.setAttribute("transform", `rotate(${(tilt * 180) / Math.PI} ${x} ${y})`);
    this.lensForce.setAttribute("d", arrow([x, y], tip, 9));
  }

  // Friction and slope of the ground under a contact.
  under(phase, n) {
    return this.film.tiles.length ? phase.ground[n] : [this.film.contacts[n].friction, 0];
  }

  // Largest height of a point over the ground under the feet.
  tallest() {
    let tallest = 0;
    for (const { first, last, step } of this.film.phases)
      for (let row = first; row <= last; row += 1)
        for (let k = 0; k < this.count; k += 1) tallest = Math.max(tallest, this.frames[`y${k}`][row] - (this.film.path[step][2] ?? 0));
    return tallest;
  }

  // Largest distance of a point from the middle of the picture, which follows the walker.
  reach() {
    let reach = 0;
    for (const { start, end, first, last } of this.film.phases)
      for (let row = first; row <= last; row += 1) {
        const [camera] = this.along(start + ((end - start) * (row - first)) / Math.max(last - first, 1));
        for (let k = 0; k < this.count; k += 1) reach = Math.max(reach, Math.abs(this.frames[`x${k}`][row] - camera));
      }
    return reach;
  }

  // Every slip of a contact in every cycle: its start time, its first and last frame, and its point.
  slips() {
    const slipping = this.film.phases.flatMap((phase) =>
      phase.contacts.flatMap((mode, n) => (mode in MARK_DEPTH ? [{ ...phase, mode, point: this.film.contacts[n].mark }] : [])));
    return Array.from({ length: this.repeats }, (_, cycle) => slipping.map((phase) => ({ ...phase, cycle }))).flat();
  }

  // Cycle, phase, and the frame (with its fraction) at a time since the start.
  moment(time) {
    const cycle = Math.min(Math.floor(time / this.film.period), this.repeats - 1);
    const t = Math.min(time - cycle * this.film.period, this.film.period);
    const phase = this.film.phases.find((phase) => t <= phase.end) ?? this.film.phases.at(-1);
    const along = (t - phase.start) / Math.max(phase.end - phase.start, 1e-12);
    const frame = phase.first + Math.max(0, along) * (phase.last - phase.first);
    return { cycle, t, phase, frame: Math.min(frame, phase.last) };
  }

  at(name, frame) {
    const column = this.frames[name];
    const before = Math.floor(frame);
    const after = Math.min(before + 1, column.length - 1);
    return column[before] + (frame - before) * (column[after] - column[before]);
  }

  draw(time) {
    const { cycle, t, phase, frame } = this.moment(time);
    const step = cycle * this.film.steps + phase.step;
    const offset = cycle * this.film.step_length;
    const points = Array.from({ length: this.count }, (_, k) => [this.at(`x${k}`, frame) + offset, this.at(`y${k}`, frame)]);
    const [along, lift] = this.along(t);
    const camera = offset + along;
    this.world.setAttribute("transform", `scale(${this.scale} ${-this.scale}) translate(${-camera} ${-lift})`);
    this.drawGround(camera);
    this.drawMarks(cycle, t, frame);
    this.join(this.legs, this.film.legs, points, this.film.sides, step);
    this.join(this.ties, this.film.ties, points, []);
    this.film.discs.forEach(([k], n) => set(this.discs[n], { cx: points[k][0], cy: points[k][1] }));
    this.film.contacts.forEach(({ point }, n) => {
      const carries = phase.contacts[n] && !phase.undetermined[n];
      for (const shape of [this.cones[n], this.forces[n]]) shape.style.display = carries ? "" : "none";
      if (carries) this.drawForce(n, points[point], frame, this.under(phase, n));
    });
    if (this.lens) this.drawMagnifier(phase, points, offset, frame, step);
    const slipped = 1000 * (this.at("x0", frame) - phase.origin);
    const known = this.film.contacts.length === 1 && phase.mode !== "flight" && Math.abs(slipped) >= 0.05;
    this.caption.textContent = `step ${step + 1}, ${t.toFixed(2)} s: ${phase.label}${known ? `, slid by ${slipped.toFixed(1)} mm` : ""}`;
  }

  // Position and height of the picture at a time of the cycle, interpolated between the starts of the steps.
  along(t) {
    const { path } = this.film;
    const k = Math.max(1, path.findIndex(([time]) => time >= t));
    const [[t0, x0, y0 = 0], [t1, x1, y1 = 0]] = [path[k - 1], path[k]];
    const fraction = (t - t0) / (t1 - t0);
    return [x0 + (x1 - x0) * fraction, y0 + (y1 - y0) * fraction];
  }

  // The two legs change their roles at every impact, so their colours follow the leg and not the role.
  join(lines, pairs, points, sides, step) {
    lines.forEach((line, n) => {
      const [[x1, y1], [x2, y2]] = pairs[n].map((k) => points[k]);
      set(line, { x1, y1, x2, y2 });
      line.classList.toggle("other", typeof sides[n] === "number" && (sides[n] + step) % 2 === 1);
      line.classList.toggle("body", sides[n] === null);
    });
  }

  drawGround(camera) {
    const reach = VIEW.width / this.scale;
    const gap = this.height / 10;
    const { tiles } = this.film;
    const level = (x) => {
      const [left, right, low, high] = tiles.find((tile) => x <= tile[1]) ?? tiles.at(-1) ?? [0, 1, 0, 0];
      return low + ((high - low) * (x - left)) / (right - left);
    };
    const corners = tiles.map(([left, right, low, high]) => `${left} ${low}L${right} ${high}`);
    let path = tiles.length ? `M${corners.join("L")}` : `M${camera - reach} 0H${camera + reach}`;
    for (let k = Math.floor((camera - reach) / gap); k * gap < camera + reach; k += 1)
      path += `M${k * gap} ${level(k * gap)}l${-gap / 2} ${-gap / 2}`;
    this.ground.setAttribute("d", path);
  }

  drawMarks(cycle, t, frame) {
    for (const { line, cycle: own, start, first, last, mode, point } of this.marks) {
      const begun = own < cycle || (own === cycle && t >= start);
      line.style.display = begun ? "" : "none";
      if (!begun) continue;
      const offset = own * this.film.step_length;
      const end = own < cycle ? last : Math.min(frame, last);
      const y = (this.film.tiles.length ? this.frames[`y${point}`][first] : 0) - MARK_DEPTH[mode] * this.height;
      set(line, { x1: this.frames[`x${point}`][first] + offset, x2: this.at(`x${point}`, end) + offset, y1: y, y2: y });
    }
  }

  drawForce(n, [x, y], frame, [mu, tilt]) {
    const top = CONE * this.height;
    const cone = Math.min(1, 0.5 / mu) * top; // a wide cone is cut off so that it stays in the picture
    this.cones[n].setAttribute("d", `M${x + mu * cone} ${y + cone}L${x} ${y}L${x - mu * cone} ${y + cone}`);
    this.cones[n].setAttribute("transform", `rotate(${(-tilt * 180) / Math.PI} ${x} ${y})`);
    const unit = (FORCE_PER_WEIGHT * this.height) / this.film.weight;
    const tip = [x + unit * this.at(`f_t${n}`, frame), y + unit * this.at(`f_n${n}`, frame)];
    this.forces[n].setAttribute("d", arrow([x, y], tip, 0.05 * this.height));
  }
}

// The path of an arrow from one point to another, with a head of a given length.
function arrow([x, y], [u, v], size) {
  const length = Math.max(Math.hypot(u - x, v - y), 1e-9);
  const [a, b] = [(u - x) / length, (v - y) / length].map((component) => size * component);
  return `M${x} ${y}L${u} ${v}M${u - a - b / 2} ${v - b + a / 2}L${u} ${v}L${u - a + b / 2} ${v - b - a / 2}`;
}
