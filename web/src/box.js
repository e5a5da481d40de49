// The box that cuts: six sides, each moved by a slider.

import { byId, make, measure } from "./dom.js";
import { Vector3 } from "./three.js";

const STEPS = 1000;

export class Box {
  /** @param {import("./view.js").View} view @param {() => void} changed */
  constructor(view, changed) {
    this.view = view;
    this.changed = changed;
    /** The sides as shares of the whole: the least of x, y, z, then the greatest. */
    this.shares = [0, 0, 0, 1, 1, 1];
    this.isOn = false;
    const sides = [0, 3, 1, 4, 2, 5].map(side => this.#side(side));
    byId("box-sides").append(...sides);
  }

  #side(side) {
    const name = `${"xyz"[side % 3]} ${side < 3 ? "from" : "to"}`;
    const range = make("input", { type: "range", min: 0, max: STEPS, value: side < 3 ? 0 : STEPS, id: `box-${side}` });
    range.addEventListener("input", () => this.#move(side, range.value / STEPS));
    return make("label", {}, name, range);
  }

  /** A side never passes the one across. */
  #move(side, share) {
    const across = this.shares[(side + 3) % 6];
    this.shares[side] = side < 3 ? Math.min(share, across) : Math.max(share, across);
    this.apply();
  }

  toggle(isOn = !this.isOn) {
    this.isOn = isOn;
    byId("box").setAttribute("aria-pressed", String(isOn));
    byId("box-sides").hidden = !isOn;
    this.apply();
  }

  apply() {
    const { least, greatest } = this.view.bounds, extent = greatest.clone().sub(least);
    const at = shares => new Vector3(...shares).multiply(extent).add(least);
    this.view.cut(this.isOn ? { least: at(this.shares.slice(0, 3)), greatest: at(this.shares.slice(3)) } : null);
    this.shares.forEach((share, side) => {
      byId(`box-${side}`).value = Math.round(share * STEPS);
      byId(`box-${side}`).title = measure(this.sides()?.[side] ?? NaN);
    });
    this.changed();
  }

  /** The sides in the file's coordinates; null where nothing is cut. */
  sides() {
    const { box } = this.view;
    return box && [...this.view.toFile(box.least), ...this.view.toFile(box.greatest)];
  }

  /** Takes sides in the file's coordinates. */
  set(sides) {
    const { least, greatest } = this.view.bounds, extent = greatest.clone().sub(least);
    const share = place => this.view.toScene(place).sub(least).divide(extent).clampScalar(0, 1).toArray();
    this.shares = [...share(sides.slice(0, 3)), ...share(sides.slice(3))];
    this.toggle(true);
  }

  /** The whole again, for another cloud. */
  reset() {
    this.shares = [0, 0, 0, 1, 1, 1];
    if (this.isOn) this.toggle(false);
  }
}
