// Play, pause, scrub and speed for a walker; the bar above the slider shows the modes of all steps.

const SPEEDS = [0.05, 0.1, 0.25, 0.5, 1, 2];
const FIRST_SPEED = 0.25;

class Player {
  // settings: speed and state of another player, which this one takes over
  constructor(host, film, settings = { speed: FIRST_SPEED, playing: !STILL.matches }) {
    this.walker = new Walker(host, film);
    this.time = 0;
    this.button = html("button", { type: "button", class: "play" });
    this.slider = html("input", { type: "range", min: 0, max: 1000, step: 1, value: 0, "aria-label": "time" });
    this.speed = html("select", { "aria-label": "speed" }, ...SPEEDS.map((speed) => html("option", { value: speed }, `${speed}×`)));
    this.speed.value = settings.speed;
    const track = html("div", { class: "track" }, modeBar(film, film.repeats), this.slider);
    host.append(html("div", { class: "controls" }, this.button, track, this.speed), modeKey(film.phases.map((phase) => phase.mode)));
    this.button.addEventListener("click", () => this.play(!this.playing));
    this.slider.addEventListener("input", () => this.seek((this.slider.value / 1000) * this.walker.duration));
    this.play(settings.playing);
  }

  get settings() {
    return { speed: this.speed.value, playing: this.playing };
  }

  play(on) {
    this.playing = on;
    this.button.textContent = on ? "Pause" : "Play";
    this.last = undefined;
    if (on) requestAnimationFrame((now) => this.tick(now));
  }

  tick(now) {
    if (!this.playing || !this.button.isConnected) return;
    const elapsed = this.last === undefined ? 0 : (now - this.last) / 1000;
    this.last = now;
    this.seek((this.time + elapsed * this.speed.value) % this.walker.duration);
    requestAnimationFrame((next) => this.tick(next));
  }

  seek(time) {
    this.time = time;
    this.slider.value = Math.round((1000 * time) / this.walker.duration);
    this.slider.setAttribute("aria-valuetext", `${time.toFixed(2)} seconds`);
    this.walker.draw(time);
  }
}

function modeBar(film, repeats) {
  const bar = html("div", { class: "modes", role: "img" });
  bar.setAttribute("aria-label", film.phases.map((phase) => phase.label).join(", "));
  for (let step = 0; step < repeats; step += 1)
    for (const { mode, label, start, end } of film.phases) {
      const piece = html("span", { class: mode, title: `${label}, ${(end - start).toPrecision(3)} s` });
      piece.style.flexGrow = end - start;
      bar.append(piece);
    }
  return bar;
}
