// How the clouds look: colours, sizes, what is up.

import { byId, make } from "./dom.js";
import { distancesTo } from "./distance.js";
import { isCategory, rangeOf } from "./drawn-cloud.js";
import * as legend from "./legend.js";

export class Look {
  /** @param {import("./view.js").View} view */
  constructor(view) {
    this.view = view;
    this.colouring = "";
    byId("colouring").addEventListener("change", event => this.choose(event.target.value));
    byId("size").addEventListener("input", event => this.setSize(Number(event.target.value)));
    byId("up").addEventListener("change", event => { this.setUp(event.target.value); view.fit(); });
    byId("shade").addEventListener("change", event => {
      view.depthShade = event.target.checked;
      view.refresh();
    });
  }

  /** Offers what the clouds that are open can be coloured by. */
  offer() {
    const clouds = this.#clouds(), all = new Map(clouds.flatMap(cloud => cloud.colourings()));
    all.set("height", "Height");
    if (this.view.slots.before && this.view.slots.after) all.set("distance", "Distance to the input");
    all.set("plain", "One colour");
    byId("colouring").replaceChildren(...[...all].map(([value, name]) => make("option", { value }, name)));
    this.choose(all.has(this.colouring) ? this.colouring : all.keys().next().value);
  }

  #clouds() {
    return this.view.drawnClouds().map(drawn => drawn.cloud);
  }

  /** Colours by something; what is not offered changes nothing. */
  async choose(colouring) {
    const select = byId("colouring");
    if (![...select.options].some(option => option.value === colouring)) return;
    this.colouring = colouring;
    select.value = colouring;
    if (colouring === "distance") await this.#measure();
    if (this.colouring === colouring) this.#apply();
  }

  /** Each of the offered ones in turn. */
  next() {
    const { options, selectedIndex } = byId("colouring");
    if (options.length > 0) this.choose(options[(selectedIndex + 1) % options.length].value);
  }

  /** Computes how far the result's points lie from the input's, once. */
  async #measure() {
    const { before, after } = this.view.slots;
    if (!before || !after || after.cloud.distances?.length === after.cloud.blocks.length) return;
    legend.clear("Measuring…");
    const distances = await distancesTo(before.cloud, after.cloud);
    after.cloud.distances = distances;
    before.cloud.distances = before.cloud.blocks.map(block => new Float32Array(block.count));
  }

  #apply() {
    const clouds = this.#clouds(), range = this.#range(clouds);
    for (const drawn of this.view.drawnClouds()) drawn.colour(this.colouring, range);
    if (["rgb", "plain", "normal"].includes(this.colouring)) legend.clear();
    else if (isCategory(this.colouring)) {
      const values = clouds.flatMap(cloud => [...cloud.sample(this.colouring)]);
      legend.showCategories(values, this.colouring === "classification");
    } else legend.showScale(this.colouring === "height" ? this.#heights() : range);
    this.view.refresh();
  }

  /** In the scene's coordinates. */
  #range(clouds) {
    const { bounds, upAxis, slots } = this.view;
    if (this.colouring === "height") return [bounds.least, bounds.greatest].map(corner => corner.getComponent(upAxis));
    if (this.colouring === "distance" && slots.after?.cloud.distances) return [0, rangeOf([slots.after.cloud], "distance")[1]];
    return rangeOf(clouds, this.colouring);
  }

  #heights() {
    const { bounds, upAxis, origin } = this.view;
    return [bounds.least, bounds.greatest].map(corner => corner.getComponent(upAxis) + origin[upAxis]);
  }

  setSize(size) {
    byId("size").value = size;
    this.view.pointSize = size;
    this.view.refresh();
  }

  setUp(up) {
    byId("up").value = up;
    this.view.setUp(up);
    if (this.colouring === "height") this.#apply();
  }
}
