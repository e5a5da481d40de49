// Nearest neighbours: a balanced k-d tree over packed positions.

const LEAF = 12;

export class Tree {
  /** O(n log n). @param {Float32Array} positions x, y, z of each point */
  constructor(positions) {
    this.positions = positions;
    const count = positions.length / 3;
    this.order = Uint32Array.from({ length: count }, (_, i) => i);
    this.axes = new Uint8Array(2 * Math.max(1, 2 ** Math.ceil(Math.log2(Math.max(1, count / LEAF)))));
    /** Where the nodes are cut. Their points go on to be put in order, so that the cut is no point's place any more. */
    this.cuts = new Float32Array(this.axes.length);
    this.#split(0, count, 1);
  }

  #split(from, to, node) {
    if (to - from <= LEAF || node >= this.axes.length) return;
    const axis = this.#widest(from, to), middle = (from + to) >> 1;
    this.axes[node] = axis;
    this.#select(from, to - 1, middle, axis);
    this.cuts[node] = this.positions[3 * this.order[middle] + axis];
    this.#split(from, middle, 2 * node);
    this.#split(middle, to, 2 * node + 1);
  }

  #widest(from, to) {
    const extents = [0, 1, 2].map(axis => {
      let least = Infinity, greatest = -Infinity;
      for (let i = from; i < to; i++) {
        const value = this.positions[3 * this.order[i] + axis];
        if (value < least) least = value;
        if (value > greatest) greatest = value;
      }
      return greatest - least;
    });
    return extents.indexOf(Math.max(...extents));
  }

  /** Puts what would be at `middle` of a sorted range there, the smaller before it. */
  #select(from, to, middle, axis) {
    const { order, positions } = this;
    while (from < to) {
      const pivot = positions[3 * order[(from + to) >> 1] + axis];
      let i = from, j = to;
      while (i <= j) {
        while (positions[3 * order[i] + axis] < pivot) i++;
        while (positions[3 * order[j] + axis] > pivot) j--;
        if (i <= j) {
          [order[i], order[j]] = [order[j], order[i]];
          i++;
          j--;
        }
      }
      if (middle <= j) to = j;
      else if (middle >= i) from = i;
      else return;
    }
  }

  /**
   * The square of the distance to the nearest point; of another than number `except`, where one is given.
   * O(log n), mostly.
   */
  nearest(x, y, z, except = -1) {
    const { order, positions, axes, cuts } = this, at = [x, y, z];
    let best = Infinity;
    const visit = (from, to, node) => {
      if (to - from <= LEAF || node >= axes.length) {
        for (let i = from; i < to; i++) {
          const point = order[i];
          const dx = positions[3 * point] - x, dy = positions[3 * point + 1] - y, dz = positions[3 * point + 2] - z;
          const square = dx * dx + dy * dy + dz * dz;
          if (square < best && point !== except) best = square;
        }
        return;
      }
      const middle = (from + to) >> 1, past = at[axes[node]] - cuts[node];
      if (past < 0) visit(from, middle, 2 * node);
      else visit(middle, to, 2 * node + 1);
      if (past * past >= best) return;
      if (past < 0) visit(middle, to, 2 * node + 1);
      else visit(from, middle, 2 * node);
    };
    visit(0, order.length, 1);
    return best;
  }
}
