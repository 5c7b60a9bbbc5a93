// A headset: the user stands in the cell; head and hands are the person's.

import * as THREE from "three";
import { STANDING, reaching } from "./person.js";

const MOVE_M_S = 1.0, TURN_RAD = Math.PI / 6, DEAD = 0.3;
const BEHIND_M = 1.2, SIGN_M = 1.35;

export class Headset {
  constructor(player) {
    Object.assign(this, { player, pressed: {} });
    const { view } = player, { xr } = view.renderer;
    xr.enabled = true;
    xr.setReferenceSpaceType("local-floor");
    this.grips = [0, 1].map((index) => {
      const grip = xr.getControllerGrip(index);
      grip.addEventListener("connected", ({ data }) => (grip.userData.source = data));
      grip.addEventListener("disconnected", () => (grip.userData.source = null));
      view.rig.add(grip);
      return grip;
    });
    this.sign();
    const button = document.getElementById("vr");
    navigator.xr?.isSessionSupported("immersive-vr").then((can) => (button.hidden = !can));
    button.addEventListener("click", () => this.enter());
    xr.addEventListener("sessionstart", () => this.begin());
    xr.addEventListener("sessionend", () => this.end());
  }

  async enter() {
    const session = await navigator.xr.requestSession("immersive-vr", { optionalFeatures: ["local-floor", "hand-tracking"] });
    await this.player.view.renderer.xr.setSession(session);
  }

  /** Stand where the person is, or at the entrance, and face the robot. */
  begin() {
    const { view, cell } = this.player, { person } = cell;
    person.take();
    const [x, y] = person.walk.place, bearing = Math.atan2(-y, -x);
    this.kept = { position: view.camera.position.clone(), quaternion: view.camera.quaternion.clone() };
    view.rig.position.set(x, 0, -y);
    view.rig.rotation.y = bearing - Math.PI / 2; // the headset looks along -z
    view.firstPerson(true);
    this.board.visible = true;
  }

  end() {
    const { view, cell } = this.player;
    view.rig.position.set(0, 0, 0);
    view.rig.rotation.y = 0;
    view.camera.position.copy(this.kept.position);
    view.camera.quaternion.copy(this.kept.quaternion);
    view.firstPerson(false);
    view.resize();
    this.board.visible = false;
    cell.person.stop();
    cell.person.target.limbs = STANDING;
  }

  /** Let the person be where head and hands are. */
  update(seconds) {
    const { view, cell } = this.player, { world, rig, renderer: { xr } } = view;
    const pose = xr.isPresenting && xr.getFrame()?.getViewerPose(xr.getReferenceSpace());
    if (!pose) return;
    const turn = new THREE.Matrix4().fromArray(pose.transform.matrix).premultiply(rig.matrixWorld);
    this.buttons(seconds, turn);
    rig.updateMatrixWorld(true);
    const head = new THREE.Matrix4().fromArray(pose.transform.matrix).premultiply(rig.matrixWorld);
    const ahead = new THREE.Vector3(0, 0, -1).transformDirection(head), yaw = Math.atan2(-ahead.z, ahead.x);
    const eyes = new THREE.Vector3().setFromMatrixPosition(head), place = world.worldToLocal(eyes.clone());
    const floor = cell.content.floor, hands = [null, null];
    for (const grip of this.grips) {
      const source = grip.userData.source;
      if (!source || !grip.visible || source.handedness === "none") continue;
      const hand = world.worldToLocal(new THREE.Vector3().setFromMatrixPosition(grip.matrixWorld));
      const [dx, dy] = [hand.x - place.x, hand.y - place.y];
      hands[source.handedness === "left" ? 0 : 1] = [dx * Math.cos(yaw) + dy * Math.sin(yaw), dy * Math.cos(yaw) - dx * Math.sin(yaw), hand.z - floor];
    }
    cell.person.goTo([place.x, place.y], yaw, reaching(hands, cell.content.body));
    this.write(eyes);
  }

  /** Left stick: walk; right stick: turn by 30°; A and B (X and Y): level up and down. */
  buttons(seconds, head) {
    const { view, cell, controls } = this.player;
    for (const { userData: { source } } of this.grips) {
      const pad = source?.gamepad;
      if (!pad) continue;
      const [x, y] = [pad.axes[2] ?? 0, pad.axes[3] ?? 0];
      if (source.handedness === "left" && Math.hypot(x, y) > DEAD) {
        const way = new THREE.Vector3(x, 0, y).transformDirection(head).setY(0);
        view.rig.position.addScaledVector(way, MOVE_M_S * Math.hypot(x, y) * seconds);
      }
      this.once(`${source.handedness} turn`, source.handedness === "right" && Math.abs(x) > 0.7, () => (view.rig.rotation.y -= Math.sign(x) * TURN_RAD));
      const change = (by) => controls.setLevel(cell.level + by);
      this.once(`${source.handedness} up`, pad.buttons[4]?.pressed, () => change(1));
      this.once(`${source.handedness} down`, pad.buttons[5]?.pressed, () => change(-1));
    }
  }

  once(name, down, act) {
    if (down && !this.pressed[name]) act();
    this.pressed[name] = down;
  }

  /** Make a board, behind the robot for the user, that shows level, stage and distance. */
  sign() {
    this.canvas = Object.assign(document.createElement("canvas"), { width: 512, height: 192 });
    this.texture = new THREE.CanvasTexture(this.canvas);
    this.texture.colorSpace = THREE.SRGBColorSpace;
    const look = { map: this.texture, toneMapped: false, fog: false };
    this.board = new THREE.Mesh(new THREE.PlaneGeometry(0.64, 0.24), new THREE.MeshBasicMaterial(look));
    this.board.visible = false;
    this.player.view.scene.add(this.board);
  }

  write(head) {
    const { cell } = this.player;
    const text = [cell.content.levels === null ? "" : `level ${cell.level} of ${cell.content.levels}`, `${cell.outcome ?? cell.stage}   ${cell.distance.toFixed(1)} m`];
    if (cell.safety.drives) text[0] = `${text[0]}   speed ${Math.round(10 * cell.safety.share) * 10} %`.trim();
    const behind = -BEHIND_M / Math.max(Math.hypot(head.x, head.z), 1e-3);
    this.board.position.set(behind * head.x, SIGN_M, behind * head.z);
    this.board.lookAt(head.x, SIGN_M, head.z);
    if (text.join() === this.written) return;
    this.written = text.join();
    const pen = this.canvas.getContext("2d");
    pen.fillStyle = "#1d2a33";
    pen.fillRect(0, 0, 512, 192);
    pen.fillStyle = "#ffffff";
    pen.font = "bold 48px system-ui, sans-serif";
    pen.textAlign = "center";
    text.forEach((line, k) => pen.fillText(line, 256, 80 + 76 * k));
    this.texture.needsUpdate = true;
  }
}
