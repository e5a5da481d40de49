// The picture: one camera, one or two clouds, as many points at a time as the machine draws smoothly.

import {
  BufferAttribute, BufferGeometry, DepthTexture, LineBasicMaterial, LineSegments, Mesh, NearestFilter, OrbitControls,
  OrthographicCamera, PerspectiveCamera, Scene, UnsignedIntType, Vector3, WebGLRenderer, WebGLRenderTarget,
} from "./three.js";
import { DrawnCloud } from "./drawn-cloud.js";
import { screenMaterial } from "./shaders.js";

/** Points that are drawn while the camera moves: at first, at least and at most. */
const BUDGET = { first: 1_000_000, least: 65_536, most: 20_000_000 };
/** The angle, in degrees, that is seen across the narrower side of a picture. */
const ANGLE = 50;
/** Milliseconds of a frame above which the budget shrinks, and below which it grows. */
const SLOW = 45, FAST = 22;
/** Milliseconds after which a frame is no longer one of the same movement. */
const PAUSE = 500;
/** Above this many pixels a pixel a phone draws more than anybody sees. */
const SHARPEST = 2;
/** How dark the edges of depth are. */
const DEPTH_SHADE = 12;

/** Ways of showing two clouds. */
export const COMPARISONS = ["before", "after", "side", "slider", "turns"];

export class View {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.renderer = new WebGLRenderer({ canvas, alpha: true, antialias: false, powerPreference: "high-performance" });
    this.renderer.autoClear = false;
    this.renderer.setClearColor(0, 0);
    /** @type {Record<string, DrawnCloud|null>} */
    this.slots = { before: null, after: null };
    this.scene = new Scene();
    this.lines = new Scene();
    this.camera = new PerspectiveCamera(ANGLE, 1, 0.1, 100);
    this.comparison = "before";
    this.split = 0.5;
    this.turn = "after";
    this.pointSize = 1;
    this.depthShade = true;
    this.budget = BUDGET.first;
    this.upAxis = 2;
    /** 1, or -1 where the axis goes down, as a camera's does. */
    this.upSign = 1;
    /** The scene's zero in the file's coordinates. */
    this.origin = [0, 0, 0];
    this.bounds = { least: new Vector3(-1, -1, -1), greatest: new Vector3(1, 1, 1) };
    this.box = null;
    /** Blocks that are drawn already, by their slot; what is missing comes with the next frames. */
    this.done = { before: 0, after: 0 };
    /** Whether the next frame begins with an empty picture. */
    this.begins = true;
    this.listeners = [];
    this.last = -Infinity;
    this.goesOn = false;
    this.#prepareScreen();
    this.#control();
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.resize();
  }

  #prepareScreen() {
    const target = new WebGLRenderTarget(1, 1, { minFilter: NearestFilter, magFilter: NearestFilter });
    target.depthTexture = new DepthTexture(1, 1, UnsignedIntType);
    this.target = target;
    this.screen = screenMaterial();
    const corners = new BufferGeometry();
    corners.setAttribute("position", new BufferAttribute(new Float32Array([-1, -1, 0, 3, -1, 0, -1, 3, 0]), 3));
    this.screenScene = new Scene();
    const all = new Mesh(corners, this.screen);
    all.frustumCulled = false;
    this.screenScene.add(all);
    this.screenCamera = new OrthographicCamera();
  }

  #control() {
    const target = this.controls ? this.controls.target.clone() : new Vector3();
    this.controls?.dispose();
    this.camera.up.set(0, 0, 0).setComponent(this.upAxis, this.upSign);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.target.copy(target);
    this.controls.zoomToCursor = true;
    this.controls.addEventListener("change", () => this.refresh());
    this.controls.update();
  }

  /** Calls back after each frame. */
  onFrame(listener) {
    this.listeners.push(listener);
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (width === 0 || height === 0) return;
    const ratio = Math.min(devicePixelRatio || 1, SHARPEST);
    this.renderer.setPixelRatio(ratio);
    this.renderer.setSize(width, height, false);
    this.target.setSize(Math.floor(width * ratio), Math.floor(height * ratio));
    this.screen.uniforms.pixel.value.set(1.4 * ratio / this.target.width, 1.4 * ratio / this.target.height);
    this.refresh();
  }

  /** Puts a cloud in a place; null takes it away. */
  place(slot, cloud) {
    const before = this.slots[slot];
    if (before) {
      this.scene.remove(before.group);
      before.dispose();
    }
    const other = this.slots[slot === "before" ? "after" : "before"];
    if (cloud && !other) this.origin = cloud.head.anchor;
    this.slots[slot] = cloud && new DrawnCloud(cloud, this.origin);
    if (this.slots[slot]) this.scene.add(this.slots[slot].group);
    this.#measure();
    this.refresh();
    return this.slots[slot];
  }

  /** Draws a further block of a cloud in its place, beside those that are drawn. */
  add(slot, block) {
    this.slots[slot].add(block);
    this.#ask();
  }

  #measure() {
    const { least, greatest } = this.bounds;
    least.setScalar(Infinity);
    greatest.setScalar(-Infinity);
    for (const drawn of this.drawnClouds()) {
      const local = place => new Vector3(...place.map((at, axis) => at - this.origin[axis]));
      least.min(local(drawn.cloud.head.least));
      greatest.max(local(drawn.cloud.head.greatest));
    }
  }

  drawnClouds() {
    return Object.values(this.slots).filter(drawn => drawn !== null);
  }

  /** Looks at all of it from a corner. */
  fit() {
    if (this.drawnClouds().length === 0) return;
    const { least, greatest } = this.bounds;
    const centre = least.clone().add(greatest).multiplyScalar(0.5), radius = Math.max(this.radius(), 1e-9);
    const from = new Vector3(-0.9, -0.9, -0.9).setComponent(this.upAxis, 0.65 * this.upSign);
    if (this.upAxis === 1) from.set(0.75, 0.45, 1).multiplyScalar(this.upSign);
    const distance = 0.82 * radius / Math.sin(radians(ANGLE / 2));
    this.camera.position.copy(centre).addScaledVector(from.normalize(), distance);
    this.controls.target.copy(centre);
    this.controls.update();
    this.refresh();
  }

  radius() {
    return this.bounds.greatest.distanceTo(this.bounds.least) / 2;
  }

  /** `z`, `y`, `x`, or `-y` where y goes down. */
  setUp(up) {
    this.upAxis = "xyz".indexOf(up.slice(-1));
    this.upSign = up.startsWith("-") ? -1 : 1;
    this.#control();
    this.refresh();
  }

  /** Turns around what is looked at, by angles; draws nearer by a factor. */
  orbit(around, over, nearer = 1) {
    const offset = this.camera.position.clone().sub(this.controls.target);
    const { up } = this.camera, side = up.clone().cross(offset).normalize();
    offset.applyAxisAngle(up, around);
    const tilt = offset.angleTo(up) + over;
    if (tilt > 0.05 && tilt < Math.PI - 0.05) offset.applyAxisAngle(side.applyAxisAngle(up, around), over);
    this.camera.position.copy(this.controls.target).addScaledVector(offset, 1 / nearer);
    this.controls.update();
    this.refresh();
  }

  /** What is drawn where: the slot, and the left and the right end of its part of the picture, from 0 to 1. */
  panes() {
    const { before, after } = this.slots;
    if (!before || !after) return [{ slot: before ? "before" : "after", from: 0, to: 1, whole: true }];
    switch (this.comparison) {
      case "side": return [{ slot: "before", from: 0, to: 0.5 }, { slot: "after", from: 0.5, to: 1 }];
      case "slider":
        return [
          { slot: "before", from: 0, to: this.split, whole: true },
          { slot: "after", from: this.split, to: 1, whole: true },
        ];
      case "turns": return [{ slot: this.turn, from: 0, to: 1, whole: true }];
      default: return [{ slot: this.comparison, from: 0, to: 1, whole: true }];
    }
  }

  /** Draws anew, from the first points on. */
  refresh() {
    this.done = { before: 0, after: 0 };
    this.begins = true;
    this.#ask();
  }

  #ask() {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame(time => {
      this.asked = false;
      this.#frame(time);
    });
  }

  #frame(time) {
    const { begins } = this;
    this.#adapt(time);
    this.begins = false;
    this.#draw(begins);
    this.#finish();
    const isLeft = ({ slot }) => this.slots[slot] && this.done[slot] < this.slots[slot].cloud.blocks.length;
    this.goesOn = this.panes().some(isLeft);
    if (this.goesOn) this.#ask();
    this.listeners.forEach(listener => listener());
  }

  /** Takes more or fewer points by how long the frame before took, where one followed another. */
  #adapt(time) {
    const took = time - this.last;
    this.last = time;
    // Between two frames of which neither asked for the other, a person may have done nothing.
    if (!this.goesOn && took > PAUSE) return;
    if (took > SLOW) this.budget = Math.max(BUDGET.least, this.budget * 0.75);
    else if (took < FAST) this.budget = Math.min(BUDGET.most, this.budget * 1.15);
  }

  /** Draws the next points of each part of the picture. */
  #draw(begins) {
    const { renderer, target } = this, [width, height] = [target.width, target.height];
    const panes = this.panes();
    renderer.setRenderTarget(target);
    target.scissorTest = true;
    this.#setPlanes();
    for (const { slot, from, to, whole } of panes) {
      const drawn = this.slots[slot];
      if (!drawn) continue;
      const left = Math.round(from * width), right = Math.round(to * width);
      target.scissor.set(left, 0, right - left, height);
      if (whole) target.viewport.set(0, 0, width, height);
      else target.viewport.set(left, 0, right - left, height);
      this.#aim(target.viewport.z / target.viewport.w);
      renderer.setRenderTarget(target);
      if (begins) renderer.clear();
      this.#drawSlot(slot, panes.length, begins);
    }
    if (panes.every(({ slot }) => !this.slots[slot])) {
      target.scissorTest = false;
      renderer.setRenderTarget(target);
      renderer.clear();
    }
  }

  #drawSlot(slot, parts, begins) {
    const drawn = this.slots[slot], from = this.done[slot];
    const to = Math.min(drawn.cloud.blocks.length, from + drawn.blocksOf(this.budget / parts));
    for (const other of this.drawnClouds()) other.group.visible = other === drawn;
    drawn.show(from, to);
    this.#setUniforms(drawn);
    this.renderer.render(this.scene, this.camera);
    if (begins) this.renderer.render(this.lines, this.camera);
    this.done[slot] = to;
  }

  #setPlanes() {
    const { least, greatest } = this.bounds, centre = least.clone().add(greatest).multiplyScalar(0.5);
    const radius = Math.max(this.radius(), 1e-9), away = this.camera.position.distanceTo(centre);
    this.camera.near = Math.max(away - 1.5 * radius, radius / 2000);
    this.camera.far = away + 2 * radius;
  }

  #setUniforms({ material: { uniforms }, cloud }) {
    const { least, greatest } = this.box || this.bounds, margin = this.box ? 0 : this.radius();
    uniforms.least.value.copy(least).addScalar(-margin);
    uniforms.greatest.value.copy(greatest).addScalar(margin);
    uniforms.upAxis.value = this.upAxis;
    // Pixels of a length of one at a distance of one.
    const pixels = this.target.viewport.w / 2 / Math.tan(radians(this.camera.fov / 2));
    uniforms.size.value = 1.5 * this.pointSize * cloud.spacing() * pixels;
    uniforms.smallest.value = 2 * this.renderer.getPixelRatio() * Math.min(1, this.pointSize);
  }

  /** Brings what was drawn to the screen. */
  #finish() {
    const { uniforms } = this.screen;
    uniforms.drawing.value = this.target.texture;
    uniforms.depth.value = this.target.depthTexture;
    uniforms.planes.value.set(this.camera.near, this.camera.far);
    uniforms.strength.value = this.depthShade ? DEPTH_SHADE : 0;
    this.renderer.setRenderTarget(null);
    this.renderer.clear();
    this.renderer.render(this.screenScene, this.screenCamera);
  }

  /** Fits the camera to a picture of this width to height. A narrow one shows as much across as a wide one does in height. */
  #aim(aspect) {
    const { camera } = this;
    camera.aspect = aspect;
    camera.fov = aspect >= 1 ? ANGLE : 2 / radians(1) * Math.atan(Math.tan(radians(ANGLE / 2)) / aspect);
    camera.updateProjectionMatrix();
  }

  /** Where a pane lies on the page, in pixels of the page, and what it shows. */
  #paneAt(x) {
    const width = this.canvas.clientWidth, share = x / width;
    const pane = this.panes().find(({ from, to }) => share >= from && share <= to) || this.panes()[0];
    return pane.whole ? { ...pane, left: 0, width } : { ...pane, left: pane.from * width, width: (pane.to - pane.from) * width };
  }

  /** The matrix from the scene to a pane, by way of the camera. */
  #projection(pane) {
    this.#aim(pane.width / this.canvas.clientHeight);
    this.camera.updateMatrixWorld();
    return this.camera.projectionMatrix.clone().multiply(this.camera.matrixWorldInverse);
  }

  /** A place of the scene on the page, in the pane at `x`; null behind the camera. */
  project(place, x = 0) {
    const pane = this.#paneAt(x), { elements: m } = this.#projection(pane);
    const w = m[3] * place.x + m[7] * place.y + m[11] * place.z + m[15];
    if (w <= 0) return null;
    const right = (m[0] * place.x + m[4] * place.y + m[8] * place.z + m[12]) / w;
    const up = (m[1] * place.x + m[5] * place.y + m[9] * place.z + m[13]) / w;
    return { x: pane.left + (right + 1) / 2 * pane.width, y: (1 - up) / 2 * this.canvas.clientHeight };
  }

  /** The point that is seen at a place of the page, or so many pixels beside it. O(points). */
  pick(x, y, reach = 8) {
    const pane = this.#paneAt(x), drawn = this.slots[pane.slot];
    if (!drawn) return null;
    const { elements: m } = this.#projection(pane), shift = drawn.group.position;
    // Half of a point's width on the page, at a distance of one.
    const radius = drawn.material.uniforms.size.value / this.renderer.getPixelRatio() / 2;
    const [halfWidth, halfHeight] = [pane.width / 2, this.canvas.clientHeight / 2];
    const [atX, atY] = [(x - pane.left) / halfWidth - 1, 1 - y / halfHeight];
    let [seen, depth, beside, off] = [null, Infinity, null, reach * reach];
    for (const { positions } of drawn.cloud.blocks) {
      for (let i = 0; i < positions.length; i += 3) {
        const px = positions[i] + shift.x, py = positions[i + 1] + shift.y, pz = positions[i + 2] + shift.z;
        const w = m[3] * px + m[7] * py + m[11] * pz + m[15];
        if (w <= 0) continue;
        const dx = ((m[0] * px + m[4] * py + m[8] * pz + m[12]) / w - atX) * halfWidth;
        const dy = ((m[1] * px + m[5] * py + m[9] * pz + m[13]) / w - atY) * halfHeight;
        // A pixel more, since a point's border is one wide.
        const square = dx * dx + dy * dy, isSeen = square < (radius / w + 1) ** 2 && w < depth;
        if (!isSeen && square >= off) continue;
        const place = new Vector3(px, py, pz);
        if (this.box && place.clone().clamp(this.box.least, this.box.greatest).distanceTo(place) > 0) continue;
        if (isSeen) [seen, depth] = [place, w];
        if (square < off) [beside, off] = [place, square];
      }
    }
    return seen || beside;
  }

  /** Draws segments between pairs of places, instead of those before under this name. */
  draw(name, places, colour) {
    const before = this.lines.getObjectByName(name);
    if (before) this.lines.remove(before);
    if (places.length > 0) {
      const geometry = new BufferGeometry().setFromPoints(places);
      const segments = new LineSegments(geometry, new LineBasicMaterial({ color: colour, depthTest: name !== "measure" }));
      segments.name = name;
      segments.frustumCulled = false;
      this.lines.add(segments);
    }
    this.refresh();
  }

  /** Shows only what lies in a box of the scene; null shows all. */
  cut(box) {
    this.box = box;
    this.draw("box", box ? edges(box) : [], 0xd08020);
  }

  /** A place of the scene in the file's coordinates, and back. */
  toFile(place) {
    return place.toArray().map((at, axis) => at + this.origin[axis]);
  }

  toScene(place) {
    return new Vector3(...place.map((at, axis) => at - this.origin[axis]));
  }
}

const radians = degrees => degrees * Math.PI / 180;

/** The twelve edges of a box. */
function edges({ least, greatest }) {
  const corner = i => new Vector3(...[0, 1, 2].map(axis => (i >> axis & 1 ? greatest : least).getComponent(axis)));
  const all = [0, 1, 2, 3, 4, 5, 6, 7];
  return all.flatMap(i => [1, 2, 4].filter(bit => !(i & bit)).flatMap(bit => [corner(i), corner(i | bit)]));
}
