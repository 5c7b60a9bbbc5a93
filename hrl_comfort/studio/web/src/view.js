// The cell in three.js: MuJoCo's bodies, the object, the tool's trail and the distance to the person.

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

const FAR = 25, TRAIL = 150, LOOK_UNIT_M = 1e-4, POINT_M = 0.036;
const ZONE_M = 0.25; // from the person's axis to the side of the body
const CALM = new THREE.Color(0x2b7a5b), NEAR = new THREE.Color(0xc0392b);

/** Return the geometry of a mesh of the content's looks. */
function shape({ vertices, faces, wide }) {
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;
  const geometry = new THREE.BufferGeometry(), places = Float32Array.from(new Int16Array(bytes(vertices)), (value) => value * LOOK_UNIT_M);
  geometry.setAttribute("position", new THREE.BufferAttribute(places, 3));
  geometry.setIndex(new THREE.BufferAttribute(wide ? new Uint32Array(bytes(faces)) : new Uint16Array(bytes(faces)), 1));
  geometry.computeVertexNormals();
  return geometry;
}

/** Return the geometry of a kind of object; MuJoCo's sizes are half sizes, and its axes are z. */
function solid(form, [first, second, third]) {
  if (form === "box") return new THREE.BoxGeometry(2 * first, 2 * second, 2 * third);
  if (form === "cylinder") return new THREE.CylinderGeometry(first, first, 2 * second, 32).rotateX(Math.PI / 2);
  if (form === "capsule") return new THREE.CapsuleGeometry(first, 2 * second, 12, 32).rotateX(Math.PI / 2);
  return new THREE.SphereGeometry(first, 32, 20);
}

export class View {
  constructor(canvas, cell) {
    this.cell = cell;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    this.renderer.shadowMap.enabled = true;
    this.renderer.toneMapping = THREE.ACESFilmicToneMapping;
    this.scene = new THREE.Scene();
    this.scene.background = new THREE.Color(0xdfe7ee);
    this.scene.fog = new THREE.Fog(0xdfe7ee, 6, 14);
    /** Cell frame: z up, origin in the robot's base; the floor is three's y = 0. */
    this.world = new THREE.Group();
    this.world.rotation.x = -Math.PI / 2;
    this.world.position.y = -cell.content.floor;
    /** Carries the camera; in VR, the room that the user walks in. */
    this.rig = new THREE.Group();
    this.camera = new THREE.PerspectiveCamera(45, 1, 0.05, 60);
    this.camera.position.set(1.5, 2.0, 2.9);
    this.rig.add(this.camera);
    this.scene.add(this.world, this.rig);
    this.orbit = new OrbitControls(this.camera, canvas);
    this.orbit.target.set(0.05, 0.72, 0);
    Object.assign(this.orbit, { enableDamping: true, maxPolarAngle: 1.5, minDistance: 0.6, maxDistance: 7 });
    this.light();
    this.build();
    addEventListener("resize", () => this.resize());
    this.resize();
  }

  light() {
    const sun = new THREE.DirectionalLight(0xffffff, 2.2);
    sun.position.set(1.5, 4, 2);
    sun.castShadow = true;
    sun.shadow.mapSize.set(1024, 1024);
    Object.assign(sun.shadow.camera, { left: -2.5, right: 2.5, top: 2.5, bottom: -2.5, near: 0.5, far: 9 });
    sun.shadow.radius = 4;
    sun.shadow.bias = -0.0005;
    this.scene.add(sun, new THREE.HemisphereLight(0xffffff, 0x9aa5ad, 1.6));
    const floor = new THREE.Mesh(new THREE.CircleGeometry(12, 64).rotateX(-Math.PI / 2), new THREE.MeshStandardMaterial({ color: 0xd3dae0, roughness: 1 }));
    floor.receiveShadow = true;
    const grid = new THREE.GridHelper(12, 24, 0xb3bfc8, 0xc4ced6);
    grid.position.y = 0.002;
    this.scene.add(floor, grid);
  }

  /** Make a group for each body, with the meshes of its looks. */
  build() {
    const { model, content } = this.cell;
    this.bodies = Array.from({ length: model.nbody }, () => new THREE.Group());
    this.bodies.forEach((group) => this.world.add(group));
    /** Meshes of the person, in order of the limbs. */
    this.person = [];
    for (const look of content.looks) {
      const [r, g, b, opacity] = look.colour, limb = model.body_mocapid[look.body], person = limb >= 0 && limb < this.cell.limbs.length;
      const material = new THREE.MeshStandardMaterial({ color: new THREE.Color().setRGB(r, g, b, THREE.SRGBColorSpace), roughness: person ? 0.85 : 0.5, metalness: person ? 0 : 0.1 });
      Object.assign(material, { transparent: opacity < 1, opacity });
      const mesh = new THREE.Mesh(shape(look), material);
      mesh.castShadow = mesh.receiveShadow = opacity === 1;
      this.bodies[look.body].add(mesh);
      if (person) this.person.push({ mesh, limb, colour: material.color.clone() });
    }
    const add = (geometry, material) => {
      const mesh = new THREE.Mesh(geometry, material);
      this.world.add(mesh);
      return mesh;
    };
    /** An object of each kind. */
    this.objects = content.kinds.map(({ shape: form, size, rgb }) => {
      const color = new THREE.Color().setRGB(...rgb, THREE.SRGBColorSpace);
      const mesh = add(solid(form, size), new THREE.MeshStandardMaterial({ roughness: 0.35, color }));
      mesh.castShadow = true;
      return mesh;
    });
    const mark = new THREE.MeshStandardMaterial({ color: 0x3aa657, transparent: true, opacity: 0.5 });
    this.points = [0, 1].map(() => add(new THREE.SphereGeometry(POINT_M, 24, 16), mark));
    /** A wide, unseen cylinder that a finger hits more easily than a limb. */
    this.handle = add(new THREE.CylinderGeometry(0.28, 0.28, 1.75, 12).rotateX(Math.PI / 2), new THREE.MeshBasicMaterial({ visible: false }));
    this.ring = add(new THREE.RingGeometry(0.3, 0.34, 48), new THREE.MeshBasicMaterial({ color: 0x2f6fb3, transparent: true, opacity: 0.6 }));
    this.ring.position.z = content.floor + 0.006;
    /** The floor that the person may reach before the arm is slow. */
    this.zone = add(new THREE.CircleGeometry(1, 64), new THREE.MeshBasicMaterial({ color: 0xe0a020, transparent: true, opacity: 0.35, depthWrite: false }));
    this.zone.position.z = content.floor + 0.004;
    this.distance = this.line(2, 0x2b7a5b, 0.9);
    this.trail = this.line(TRAIL, 0xe6781e, 0.75);
    this.tool = [];
  }

  line(points, color, opacity) {
    const geometry = new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(new Float32Array(3 * points), 3));
    const line = new THREE.Line(geometry, new THREE.LineBasicMaterial({ color, transparent: true, opacity }));
    line.frustumCulled = false;
    this.world.add(line);
    return line;
  }

  resize() {
    if (this.renderer.xr.isPresenting) return;
    const { innerWidth: width, innerHeight: height } = window;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.fov = width < height ? 62 : 45;
    this.camera.updateProjectionMatrix();
    this.stale = true;
  }

  /** Return where every body is now. */
  picture() {
    const { data, objectPlace, state } = this.cell;
    return { places: data.xpos.slice(), turns: data.xquat.slice(), object: objectPlace && [...objectPlace], tool: [...state.tcp_pos] };
  }

  /** Remember where the tool is. */
  remember({ tool }) {
    this.tool.push(tool);
    if (this.tool.length > TRAIL) this.tool.shift();
  }

  /** Show the picture a share of the way from one to another. */
  show(before, after, share) {
    const { cell } = this, { content } = cell, turn = new THREE.Quaternion();
    const from = new THREE.Vector3(), mix = (a, b) => from.fromArray(a).lerp(new THREE.Vector3(...b), share);
    this.bodies.forEach((group, body) => {
      const [w, x, y, z] = after.turns.slice(4 * body, 4 * body + 4), old = before.turns.slice(4 * body, 4 * body + 4);
      group.position.copy(mix(before.places.slice(3 * body, 3 * body + 3), after.places.slice(3 * body, 3 * body + 3)));
      group.quaternion.set(old[1], old[2], old[3], old[0]).slerp(turn.set(x, y, z, w), share);
      group.visible = group.position.x < FAR;
    });
    this.objects.forEach((mesh, kind) => {
      mesh.visible = after.object !== null && kind === cell.object.kind;
      if (mesh.visible) mesh.position.copy(mix(before.object ?? after.object, after.object));
    });
    this.points.forEach((mesh, k) => {
      mesh.visible = k < content.stages.points.filter(Boolean).length;
      mesh.position.fromArray(content.episodes[cell.episode].points[k]);
    });
    const [x, y] = cell.person.walk.place, { there } = cell.person;
    this.handle.position.set(x, y, content.floor + 0.875);
    this.ring.visible = cell.person.byHand && there;
    this.ring.position.setX(x).setY(y);
    const { given, reach } = cell.safety;
    this.zone.visible = given.shielded && there && reach > 0;
    this.zone.position.setX(x).setY(y);
    this.zone.scale.setScalar(ZONE_M + reach);
    this.draw(this.trail, this.tool);
    const tool = mix(before.tool, after.tool).toArray();
    this.distance.visible = there && !this.renderer.xr.isPresenting;
    this.distance.material.color.copy(NEAR).lerp(CALM, Math.min(1, Math.max(0, (cell.distance - 0.25) / 0.5)));
    this.draw(this.distance, [tool, [x, y, tool[2]]]);
  }

  draw(line, points) {
    const places = line.geometry.attributes.position;
    points.forEach((point, k) => places.setXYZ(k, ...point));
    places.needsUpdate = true;
    line.geometry.setDrawRange(0, points.length);
  }

  /** Paint the person red while they are touched. */
  flash(contact) {
    for (const { mesh, colour } of this.person) mesh.material.color.copy(contact ? NEAR : colour);
  }

  /** Hide the limbs that a person does not see of themselves: trunk, head and legs. */
  firstPerson(inside) {
    for (const { mesh, limb } of this.person) mesh.visible = !inside || limb > 2;
  }

  /** Return the ray of a pointer event, in the cell frame. */
  ray(event) {
    this.scene.updateMatrixWorld(); // the last picture may be older
    const { left, top, width, height } = this.renderer.domElement.getBoundingClientRect();
    const caster = new THREE.Raycaster();
    caster.setFromCamera(new THREE.Vector2((2 * (event.clientX - left)) / width - 1, 1 - (2 * (event.clientY - top)) / height), this.camera);
    return caster;
  }

  /** Return the point of the person (in the cell frame) that a pointer is on, or null. */
  grabbed(event) {
    if (!this.cell.person.there) return null;
    const [hit] = this.ray(event).intersectObject(this.handle);
    return hit ? this.world.worldToLocal(hit.point) : null;
  }

  /** Return where a pointer's ray meets a height (m) of the cell, or null. */
  onPlane(event, height) {
    const plane = new THREE.Plane(new THREE.Vector3(0, 1, 0), -(height + this.world.position.y));
    const point = this.ray(event).ray.intersectPlane(plane, new THREE.Vector3());
    return point && this.world.worldToLocal(point);
  }

  /** Draw, unless nothing has moved since. */
  render(moved) {
    const turned = !this.renderer.xr.isPresenting && this.orbit.update();
    if (moved || turned || this.stale || this.renderer.xr.isPresenting) this.renderer.render(this.scene, this.camera);
    this.stale = false;
  }
}
