// Mouse, touch, keys, gamepad and the panel.

const KEYS = { KeyW: [1, 0], KeyS: [-1, 0], KeyA: [0, 1], KeyD: [0, -1] }, TURNS = { KeyQ: 1, KeyE: -1 };
const TURN_RAD_S = 1.5, DEAD = 0.2, SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
const $ = (id) => document.getElementById(id);

export class Controls {
  constructor(player) {
    this.player = player;
    this.held = new Set();
    this.pressed = [];
    const { cell, view } = player, { content } = cell;
    $("title").textContent = content.title;
    $("levels").hidden = content.levels === null;
    $("no-levels").hidden = content.levels !== null;
    $("level").max = content.levels ?? 1;
    for (const part of document.querySelectorAll(".drive")) part.hidden = !cell.safety.drives;
    $("ease").textContent = `${content.levels}: at ease`;
    $("level").addEventListener("input", () => this.setLevel(Number($("level").value)));
    $("run").addEventListener("click", () => this.toggle());
    $("one").addEventListener("click", () => this.one());
    $("reset").addEventListener("click", () => player.reset());
    $("free").addEventListener("click", () => cell.person.letGo());
    $("speed").append(...SPEEDS.map((speed) => new Option(`${speed} ×`, speed, speed === 1, speed === 1)));
    $("speed").addEventListener("change", () => (player.speed = Number($("speed").value)));
    this.setLevel(cell.level);
    this.drag(view.renderer.domElement);
    addEventListener("keydown", (event) => this.key(event, true));
    addEventListener("keyup", (event) => this.key(event, false));
    addEventListener("blur", () => this.release());
    cell.watchers.push((outcome) => ($("outcome").textContent = `last episode: ${outcome}`));
  }

  setLevel(level) {
    const { cell } = this.player;
    cell.level = Math.min(Math.max(level, 1), cell.content.levels ?? level);
    $("level").value = cell.level;
    $("level-value").textContent = cell.level;
  }

  toggle() {
    this.player.running = !this.player.running;
  }

  one() {
    this.player.running = false;
    this.player.decide();
  }

  /** Drag the person over the floor by the pointer; elsewhere the pointer moves the camera. */
  drag(canvas) {
    const { view, cell } = this.player;
    let grip = null;
    const over = (event) => (canvas.style.cursor = grip ? "grabbing" : event.pointerType === "mouse" && view.grabbed(event) ? "grab" : "");
    canvas.addEventListener("pointerdown", (event) => {
      const point = event.button === 0 && !grip && view.grabbed(event);
      if (!point) return;
      const [x, y] = cell.person.walk.place;
      grip = { pointer: event.pointerId, height: point.z, offset: [x - point.x, y - point.y] };
      view.orbit.enabled = false;
      canvas.setPointerCapture(event.pointerId);
      cell.person.take();
    }, true);
    canvas.addEventListener("pointermove", (event) => {
      over(event);
      if (!grip || event.pointerId !== grip.pointer) return;
      const point = view.onPlane(event, grip.height);
      if (point) cell.person.goTo([point.x + grip.offset[0], point.y + grip.offset[1]]);
    });
    for (const name of ["pointerup", "pointercancel"])
      canvas.addEventListener(name, (event) => {
        if (grip?.pointer !== event.pointerId) return;
        grip = null;
        view.orbit.enabled = true;
        over(event);
      });
  }

  key(event, down) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest?.("select")) return;
    if (event.code in KEYS || event.code in TURNS) {
      down ? this.held.add(event.code) : this.held.delete(event.code);
      if (!down && !this.held.size) this.player.cell.person.stop();
    } else if (down && event.code === "Space" && event.target.tagName !== "BUTTON") this.toggle();
    else if (down && event.code === "Period") this.one();
    else if (down && event.code === "KeyR") this.player.reset();
    else if (down && event.code === "BracketLeft") this.setLevel(this.player.cell.level - 1);
    else if (down && event.code === "BracketRight") this.setLevel(this.player.cell.level + 1);
    else return;
    event.preventDefault();
  }

  release() {
    if (this.held.size) this.player.cell.person.stop();
    this.held.clear();
  }

  /** Walk as keys and gamepads say. */
  update(seconds) {
    const { cell, view } = this.player, { person } = cell;
    if (this.held.size) {
      let [ahead, left, turn] = [0, 0, 0];
      for (const code of this.held) {
        ahead += KEYS[code]?.[0] ?? 0;
        left += KEYS[code]?.[1] ?? 0;
        turn += TURNS[code] ?? 0;
      }
      this.walk(ahead, left, person.walk.yaw + turn * TURN_RAD_S * seconds);
    }
    const pad = Array.from(navigator.getGamepads?.() ?? []).find((each) => each?.mapping === "standard");
    if (!pad || view.renderer.xr.isPresenting) return;
    const [x, y, turn] = pad.axes.map((axis) => (Math.abs(axis) < DEAD ? 0 : axis));
    if (x || y || turn) {
      // The left stick walks away from the camera, the right one turns.
      const away = view.camera.getWorldDirection(view.camera.position.clone()), bearing = Math.atan2(-away.z, away.x);
      const way = bearing + Math.atan2(-x, -y), far = Math.min(1, Math.hypot(x, y));
      const yaw = turn ? person.walk.yaw - turn * TURN_RAD_S * seconds : far ? way : person.walk.yaw;
      this.walk(far * Math.cos(way - yaw), far * Math.sin(way - yaw), yaw);
      this.stick = true;
    } else if (this.stick) {
      this.stick = false;
      person.stop();
    }
    const actions = { 0: () => this.toggle(), 1: () => this.player.reset(), 4: () => this.setLevel(cell.level - 1), 5: () => this.setLevel(cell.level + 1) };
    for (const [button, act] of Object.entries(actions)) {
      const down = pad.buttons[button]?.pressed ?? false;
      if (down && !this.pressed[button]) act();
      this.pressed[button] = down;
    }
  }

  /** Walk ahead and to the left, shares of the speed limit, in a bearing; the target is what two decisions reach. */
  walk(ahead, left, yaw) {
    const { person } = this.player.cell, far = (0.2 * person.speedLimit) / Math.max(1, Math.hypot(ahead, left));
    const [cos, sin] = [Math.cos(yaw), Math.sin(yaw)];
    person.take();
    const [x, y] = person.walk.place, limbs = person.walk.limbs;
    person.goTo([x + far * (ahead * cos - left * sin), y + far * (ahead * sin + left * cos)], yaw, limbs);
    if (!this.player.running) person.walk = { ...person.walk, yaw };
  }

  /** Write what the cell does into the panel. */
  refresh() {
    const { cell, running } = this.player, { content, counts, state } = cell;
    const text = (id, value) => $(id).textContent !== value && ($(id).textContent = value);
    text("run", running ? "Pause" : "Run");
    text("stage", cell.outcome ?? cell.stage);
    text("option", content.options.length > 1 ? `policy ${content.options[cell.option].name}` : "one policy");
    text("distance", cell.person.there ? `${cell.distance.toFixed(2)} m` : "nobody here");
    text("time", `${(state.steps * 0.02).toFixed(1)} s`);
    const { touches, safety } = cell;
    text("touches", `${touches.all}, ${touches.unsafe} unsafe`);
    text("share", `${Math.round(100 * safety.share)} %`);
    text("stops", String(safety.stops));
    text("counts", `${counts.success} done, ${counts.contact + counts.other} failed`);
    $("free").hidden = !cell.person.byHand;
    $("readout").classList.toggle("contact", state.touching || cell.failedContact);
  }
}
