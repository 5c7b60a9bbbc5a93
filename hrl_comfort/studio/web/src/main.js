// The page: loads what is in it, plays the cell in real time, and connects its controls.

import loadMujoco from "@mujoco/mujoco";
import { Cell } from "./cell.js";
import { Controls } from "./controls.js";
import { View } from "./view.js";
import { Headset } from "./headset.js";
import { limbPoses } from "./person.js";

const STEP_S = 0.02, PAUSE_S = 0.7, LONGEST_S = 0.2;

/** Return the bytes of a script element that holds a gzipped file in base64. */
async function unpacked(id) {
  const packed = await (await fetch(`data:application/octet-stream;base64,${document.getElementById(id).textContent.trim()}`)).blob();
  return new Response(packed.stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
}

class Player {
  constructor(cell, view) {
    Object.assign(this, { cell, view, running: true, speed: 1, debt: 0, wait: 0 });
    this.begin();
  }

  begin() {
    this.before = this.after = this.view.picture();
    this.view.tool = [];
  }

  reset() {
    this.cell.reset();
    this.wait = 0;
    this.begin();
  }

  /** Run one control step; true where a decision ended. */
  step() {
    if (this.cell.outcome) this.reset();
    const ended = this.cell.step();
    this.before = this.after;
    this.after = this.view.picture();
    this.view.remember(this.after);
    if (this.cell.outcome) this.wait = PAUSE_S;
    return ended;
  }

  /** Run one decision. */
  decide() {
    while (!this.step());
    this.before = this.after;
  }

  /** Let some time pass, s. */
  pass(seconds) {
    if (this.running) {
      this.debt += Math.min(seconds, LONGEST_S) * this.speed;
      while (this.debt >= STEP_S) {
        this.debt -= STEP_S;
        if (this.wait > 0) this.wait -= STEP_S;
        else this.step();
      }
    }
    this.view.show(this.before, this.after, this.running && this.wait <= 0 ? this.debt / STEP_S : 1);
    this.view.flash(this.cell.state.touching || this.cell.failedContact);
  }
}

async function main() {
  const [wasm, packed] = await Promise.all([unpacked("wasm"), unpacked("content")]);
  const cell = new Cell(await loadMujoco({ wasmBinary: wasm }), JSON.parse(new TextDecoder().decode(packed)));
  const view = new View(document.getElementById("view"), cell), player = new Player(cell, view);
  const controls = (player.controls = new Controls(player)), headset = new Headset(player);
  let last = null, drawn = null;
  view.renderer.setAnimationLoop((time) => {
    const passed = last === null ? 0 : (time - last) / 1000;
    last = time;
    controls.update(passed);
    headset.update(passed);
    player.pass(passed);
    controls.refresh();
    view.render(player.running || drawn !== player.after);
    drawn = player.after;
  });
  document.body.classList.add("ready");
  window.player = Object.assign(player, { limbPoses });
}

main().catch((error) => {
  document.getElementById("loading").textContent = `This page cannot run here: ${error.message}`;
  throw error;
});
