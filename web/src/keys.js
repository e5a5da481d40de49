// What can be done by keys.

import { byId, make } from "./dom.js";

const STEP = Math.PI / 24;

/** Binds the keys, and tells of them in the dialog that they open. */
export function bindKeys({ view, look, comparison, ruler, box, openFile, upsample, download }) {
  const keys = [
    [["o"], "Open a file", openFile],
    [["u"], "Upsample", upsample],
    [["d"], "Download", download],
    [["c"], "Colour by the next thing", () => look.next()],
    [["v"], "Compare in the next way", () => comparison.next()],
    [["b"], "Before, then after", () => comparison.turn()],
    [["m"], "Measure a distance", () => ruler.toggle()],
    [["x"], "Cut with a box", () => box.toggle()],
    [["f"], "Show all", () => view.fit()],
    [["ArrowLeft"], "Turn left", () => view.orbit(-STEP, 0)],
    [["ArrowRight"], "Turn right", () => view.orbit(STEP, 0)],
    [["ArrowUp"], "Turn up", () => view.orbit(0, -STEP)],
    [["ArrowDown"], "Turn down", () => view.orbit(0, STEP)],
    [["+", "="], "Nearer", () => view.orbit(0, 0, 1.15)],
    [["-"], "Further away", () => view.orbit(0, 0, 1 / 1.15)],
    [["?"], "This list", () => byId("help").showModal()],
  ];
  const names = { ArrowLeft: "←", ArrowRight: "→", ArrowUp: "↑", ArrowDown: "↓" };
  byId("help-keys").append(...keys.flatMap(([[key], told]) => [make("dt", {}, make("kbd", {}, names[key] || key)), make("dd", {}, told)]));
  byId("help-open").addEventListener("click", () => byId("help").showModal());
  document.addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
    // Where something is typed or chosen, keys mean that.
    const { tagName } = /** @type {HTMLElement} */ (event.target);
    if (["INPUT", "SELECT"].includes(tagName)) return;
    const found = keys.find(([all]) => all.includes(event.key));
    if (!found) return;
    event.preventDefault();
    found[2]();
  });
}
