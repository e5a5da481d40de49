// What the colours mean.

import { byId, make, measure } from "./dom.js";
import { CATEGORIES, SCALE } from "./shaders.js";

/** The classes of LAS, as its specification names them. */
const CLASSES = [
  "never classified", "unclassified", "ground", "low vegetation", "medium vegetation", "high vegetation", "building",
  "low noise", "reserved", "water", "rail", "road", "reserved", "wire, guard", "wire, conductor", "tower",
  "wire connector", "bridge deck", "high noise",
];
const MOST = 24;

const css = colour => `rgb(${colour.join(" ")})`;

/** Shows nothing, for colours that speak for themselves. */
export const clear = (...told) => byId("legend").replaceChildren(...told);

/** @param {number[]} range */
export function showScale([from, to]) {
  const bar = make("canvas", { width: 256, height: 1 }), context = bar.getContext("2d");
  const gradient = context.createLinearGradient(0, 0, 256, 0);
  SCALE.forEach((colour, i) => gradient.addColorStop(i / (SCALE.length - 1), css(colour)));
  context.fillStyle = gradient;
  context.fillRect(0, 0, 256, 1);
  const ends = make("div", { className: "ends" }, make("span", {}, measure(from)), make("span", {}, measure(to)));
  clear(bar, ends);
}

export function showCategories(values, isClass) {
  const found = [...new Set(values)].filter(Number.isFinite).sort((a, b) => a - b);
  const items = found.slice(0, MOST).map(value =>
    make("li", {}, swatch(CATEGORIES[value % CATEGORIES.length]), isClass && CLASSES[value] || String(value)));
  if (found.length > MOST) items.push(make("li", {}, `and ${found.length - MOST} more`));
  clear(make("ul", {}, ...items));
}

function swatch(colour) {
  const dot = make("span", { className: "swatch" });
  dot.style.background = css(colour);
  return dot;
}
