// Measuring the distance between two points.

import { byId, measure } from "./dom.js";

export class Ruler {
  /** @param {import("./view.js").View} view */
  constructor(view) {
    this.view = view;
    /** @type {import("three").Vector3[]} */
    this.places = [];
    this.isOn = false;
    view.onFrame(() => this.#label());
  }

  toggle(isOn = !this.isOn) {
    this.isOn = isOn;
    this.places = [];
    byId("measure").setAttribute("aria-pressed", String(isOn));
    byId("stage").classList.toggle("measuring", isOn);
    this.#show();
  }

  /** Takes the point at a place of the page; a third one begins anew. */
  take(x, y) {
    const place = this.view.pick(x, y);
    if (!place) return;
    if (this.places.length === 2) this.places = [];
    this.places.push(place);
    this.at = x;
    this.#show();
  }

  #show() {
    const told = byId("measure-told"), [a, b] = this.places;
    this.view.draw("measure", b ? [a, b] : [], 0xe04040);
    if (!this.isOn) told.textContent = "";
    else if (!a) told.textContent = "Choose the first point.";
    else if (!b) told.textContent = "Choose the second point.";
    else {
      const apart = b.clone().sub(a);
      const parts = apart.toArray().map((part, axis) => `${"xyz"[axis]} ${measure(part)}`).join(", ");
      told.textContent = `${measure(apart.length())} apart (${parts})`;
    }
  }

  /** The distance, where the line is on the page. */
  #label() {
    const label = byId("measured"), [a, b] = this.places;
    const middle = b && this.view.project(a.clone().add(b).multiplyScalar(0.5), this.at);
    label.hidden = !middle;
    if (!middle) return;
    label.textContent = measure(a.distanceTo(b));
    label.style.left = `${middle.x}px`;
    label.style.top = `${middle.y}px`;
  }
}
