// Before and after: side by side, by a slider, in turns, or one alone.

import { byId, make, whole } from "./dom.js";

const NAMES = { before: "Before", after: "After", side: "Side by side", slider: "Slider", turns: "In turns" };
/** Milliseconds of a turn. */
const TURN = 1200;

export class Comparison {
  /** @param {import("./view.js").View} view */
  constructor(view) {
    this.view = view;
    const choices = Object.entries(NAMES).map(([value, name]) => {
      const radio = make("input", { type: "radio", name: "comparison", value });
      radio.addEventListener("change", () => this.choose(value));
      return make("label", {}, radio, make("span", {}, name));
    });
    byId("comparisons").append(...choices);
    this.#bindDivider();
    view.onFrame(() => this.#tell());
  }

  /** What there is to be compared has changed. */
  offer() {
    const { before, after } = this.view.slots, both = before !== null && after !== null;
    byId("compare").hidden = !both;
    this.choose(both ? "slider" : before ? "before" : "after");
  }

  choose(comparison) {
    if (!(comparison in NAMES)) return;
    this.view.comparison = comparison;
    const radio = /** @type {HTMLInputElement} */ (document.querySelector(`[name=comparison][value=${comparison}]`));
    radio.checked = true;
    clearInterval(this.turning);
    // Whoever wants less motion turns by the key alone.
    if (comparison === "turns" && !matchMedia("(prefers-reduced-motion)").matches) this.turning = setInterval(() => this.turn(), TURN);
    this.#place();
    this.view.refresh();
  }

  /** Each in turn. */
  next() {
    const all = Object.keys(NAMES);
    if (!byId("compare").hidden) this.choose(all[(all.indexOf(this.view.comparison) + 1) % all.length]);
  }

  /** The other one of the two. */
  turn() {
    if (byId("compare").hidden) return;
    if (this.view.comparison !== "turns") this.choose(this.view.comparison === "before" ? "after" : "before");
    this.view.turn = this.view.turn === "before" ? "after" : "before";
    this.view.refresh();
  }

  moveTo(split) {
    this.view.split = Math.min(1, Math.max(0, split));
    this.#place();
    this.view.refresh();
  }

  #place() {
    const divider = byId("divider"), { comparison, slots } = this.view;
    divider.hidden = !(slots.before && slots.after) || comparison !== "slider" && comparison !== "side";
    divider.classList.toggle("fixed", comparison === "side");
    const split = comparison === "side" ? 0.5 : this.view.split;
    divider.style.left = `${100 * split}%`;
    divider.setAttribute("aria-valuenow", String(Math.round(100 * split)));
  }

  #bindDivider() {
    const divider = byId("divider");
    const move = ({ clientX }) => {
      const { left, width } = this.view.canvas.getBoundingClientRect();
      this.moveTo((clientX - left) / width);
    };
    divider.addEventListener("pointerdown", event => {
      divider.setPointerCapture(event.pointerId);
      divider.onpointermove = move;
    });
    divider.addEventListener("pointerup", () => { divider.onpointermove = null; });
    divider.addEventListener("keydown", event => {
      const step = { ArrowLeft: -0.02, ArrowRight: 0.02, Home: -1, End: 1 }[event.key];
      if (step === undefined) return;
      event.preventDefault();
      event.stopPropagation();
      this.moveTo(this.view.split + step);
    });
  }

  /** Says which cloud is where, and how many points are drawn. */
  #tell() {
    const panes = this.view.panes(), { slots } = this.view;
    const text = ({ slot }) => slots[slot] && `${NAMES[slot]}: ${whole(slots[slot].cloud.head.points)} points`;
    const isPair = slots.before !== null && slots.after !== null;
    ["tag-left", "tag-right"].forEach((id, i) => {
      byId(id).hidden = !panes[i] || !isPair;
      byId(id).textContent = panes[i] && text(panes[i]) || "";
    });
    let drawn = 0;
    for (const { slot } of panes) drawn += drawnOf(slots[slot], this.view.done[slot]);
    byId("drawn").textContent = drawn > 0 ? `${whole(drawn)} drawn` : "";
  }
}

/** Points of a cloud that are on the screen so far. */
const drawnOf = (drawn, done) => drawn ? drawn.cloud.blocks.slice(0, done).reduce((sum, { count }) => sum + count, 0) : 0;
