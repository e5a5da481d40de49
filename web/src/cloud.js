// A cloud as the page has it: blocks of points, coarse to fine, about an anchor in the file's own coordinates.

import { Tree } from "./tree.js";

/** Points whose neighbours tell the spacing. */
const SAMPLE = 20_000;
const ASKED = 800;

/** The columns that a direction is made of. */
const NORMAL = ["nx", "ny", "nz"];
/** Columns that points can be coloured by, and how a person calls them. */
const SCALARS = {
  intensity: "Intensity",
  reflectance: "Reflectance",
  classification: "Class",
  label: "Label",
  confidence: "Confidence",
  grey: "Grey",
  nir: "Near infrared",
  return_number: "Return",
};

export class Cloud {
  /** @param {string} name @param {import("./packed.js").Head} head */
  constructor(name, head) {
    this.name = name;
    this.head = head;
    /** @type {import("./packed.js").Block[]} */
    this.blocks = [];
    this.count = 0;
    /** Distances to another cloud, a column a block, once they are known. @type {Float32Array[]|null} */
    this.distances = null;
    /** @type {number|undefined} */
    this.known = undefined;
  }

  /** @param {import("./packed.js").Block} block */
  add(block) {
    this.blocks.push(block);
    this.count += block.count;
  }

  /** The place of a column among the others; -1 where there is none. */
  column(role) {
    return this.head.columns.findIndex(column => column.role === role);
  }

  /** What its points can be coloured by, besides their height: keys and names. @returns {[string, string][]} */
  colourings() {
    const found = /** @type {[string, string][]} */ ([]);
    if (this.head.colours) found.push(["rgb", "Colour"]);
    if (NORMAL.every(role => this.column(role) >= 0)) found.push(["normal", "Normal"]);
    for (const [role, name] of Object.entries(SCALARS)) if (this.column(role) >= 0) found.push([role, name]);
    return found;
  }

  /** Where three columns lie that are a normal's parts. */
  normalColumns() {
    return NORMAL.map(role => this.column(role));
  }

  /** The mean distance to the nearest neighbour, about, told from the first points of the even order; 0 before these. */
  spacing() {
    if (this.known === undefined && this.count > 0) this.known = spacingOf(this);
    return this.known || 0;
  }

  /** The values of a column, or of the distances, of the first points: for what is typical of them. */
  sample(role) {
    const columns = role === "distance" ? this.distances : this.blocks.map(block => block.columns[this.column(role)]);
    return columns?.[0]?.subarray(0, SAMPLE) || new Float32Array(0);
  }
}

function spacingOf({ blocks, head }) {
  const first = blocks[0].positions.subarray(0, 3 * Math.min(SAMPLE, blocks[0].count));
  const tree = new Tree(first), points = first.length / 3, step = Math.max(1, Math.floor(points / ASKED));
  const distances = [];
  for (let i = 0; i < points; i += step) {
    const square = tree.nearest(first[3 * i], first[3 * i + 1], first[3 * i + 2], i);
    if (square > 0 && square < Infinity) distances.push(Math.sqrt(square));
  }
  if (distances.length === 0) return 0;
  distances.sort((a, b) => a - b);
  // Of a surface: four times the points lie half as far apart.
  return distances[distances.length >> 1] * Math.sqrt(points / Math.max(points, head.points));
}

/** The values between which all but some hundredths lie, so that few extreme ones take no colour from the others. */
export function usualRange(values, cut = 0.02) {
  const sorted = Float32Array.from(values).filter(Number.isFinite).sort();
  if (sorted.length === 0) return [0, 1];
  const at = share => sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))];
  const range = [at(cut), at(1 - cut)];
  return range[1] > range[0] ? range : [sorted[0], sorted[sorted.length - 1]];
}
