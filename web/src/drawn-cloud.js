// A cloud on the graphics card: an object a block, so that any number of blocks from the first on can be drawn.

import { BufferAttribute, BufferGeometry, Group, Points } from "./three.js";
import { usualRange } from "./cloud.js";
import { MODES, pointMaterial } from "./shaders.js";

/** Columns whose numbers are names and not measures. */
const CATEGORIES = ["classification", "label"];

export class DrawnCloud {
  /** @param {import("./cloud.js").Cloud} cloud @param {number[]} origin what the scene's zero is in the file's coordinates */
  constructor(cloud, origin) {
    this.cloud = cloud;
    this.material = pointMaterial();
    this.group = new Group();
    this.group.position.fromArray(cloud.head.anchor.map((at, axis) => at - origin[axis]));
    /** How all blocks are coloured; a new one is so, too. */
    this.colouring = "height";
    cloud.blocks.forEach(block => this.add(block));
  }

  add(block) {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(block.positions, 3));
    if (block.colours) geometry.setAttribute("colour", new BufferAttribute(block.colours, 4, true));
    const points = new Points(geometry, this.material);
    points.frustumCulled = false;
    this.group.add(points);
    this.#give(this.group.children.length - 1);
  }

  /** Draws blocks `from` up to, and without, `to`. */
  show(from, to) {
    this.group.children.forEach((points, i) => { points.visible = i >= from && i < to; });
  }

  /** How many blocks hold so many points. */
  blocksOf(points) {
    let left = points;
    const beyond = this.cloud.blocks.findIndex(block => (left -= block.count) < 0);
    return beyond < 0 ? this.cloud.blocks.length : Math.max(1, beyond);
  }

  /** Colours all points: `rgb`, `normal`, `height`, `distance`, `plain` or a column's role. */
  colour(colouring, range) {
    this.colouring = this.#has(colouring) ? colouring : "plain";
    const { uniforms } = this.material;
    uniforms.mode.value = modeOf(this.colouring);
    if (range) uniforms.range.value.fromArray(range);
    this.group.children.forEach((_, i) => this.#give(i));
  }

  #has(colouring) {
    if (colouring === "height" || colouring === "plain") return true;
    if (colouring === "distance") return this.cloud.distances !== null;
    return this.cloud.colourings().some(([key]) => key === colouring);
  }

  /** Gives a block what its colouring needs. */
  #give(i) {
    const { cloud, colouring } = this, block = cloud.blocks[i];
    const { geometry } = /** @type {Points} */ (this.group.children[i]);
    if (colouring === "normal") {
      if (!geometry.hasAttribute("direction")) geometry.setAttribute("direction", directions(cloud, block));
      return;
    }
    const values = colouring === "distance" ? cloud.distances?.[i] : block.columns[cloud.column(colouring)];
    if (values) geometry.setAttribute("scalar", new BufferAttribute(values, 1));
  }

  dispose() {
    this.group.children.forEach(points => /** @type {Points} */ (points).geometry.dispose());
    this.material.dispose();
  }
}

function modeOf(colouring) {
  if (colouring in MODES) return MODES[colouring];
  return CATEGORIES.includes(colouring) ? MODES.category : MODES.scalar;
}

export const isCategory = colouring => CATEGORIES.includes(colouring);

/** The normals of a block, as one attribute. */
function directions(cloud, block) {
  const parts = cloud.normalColumns().map(column => block.columns[column]);
  const all = new Float32Array(3 * block.count);
  for (let i = 0; i < all.length; i++) all[i] = parts[i % 3][(i / 3) | 0];
  return new BufferAttribute(all, 3);
}

/** The values that a colouring's scale goes from and to, over some clouds. */
export function rangeOf(clouds, colouring) {
  if (colouring === "confidence") return [0, 1];
  const samples = clouds.map(cloud => cloud.sample(colouring)).filter(sample => sample.length > 0);
  const ranges = samples.map(sample => usualRange(sample));
  return ranges.length === 0 ? [0, 1] : [Math.min(...ranges.map(([a]) => a)), Math.max(...ranges.map(([, b]) => b))];
}
