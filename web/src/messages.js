// What the page tells.

import { byId, make, measure, whole } from "./dom.js";
import { isStopped, keepKey } from "./server.js";

/** How something goes; nothing takes that away. What went wrong before is over then. */
export function say(text) {
  byId("status").textContent = text;
  byId("error").hidden = true;
}

/** What went wrong, unless a person has stopped it. */
export function fail(error) {
  if (isStopped(error)) return;
  byId("status").textContent = "";
  byId("error").textContent = error.status ? `${error.title}: ${error.message}` : error.message;
  byId("error").hidden = false;
}

/** How far the work is. @param {import("./work.js").Progress} progress */
export function tell({ fraction, text }) {
  const bar = byId("progress");
  bar.hidden = false;
  if (fraction === null) bar.removeAttribute("value");
  else bar.value = fraction;
  byId("stage-name").textContent = text;
}

/** What a person should know about the clouds. */
export const warn = warnings => byId("warnings").replaceChildren(...warnings.map(text => make("li", {}, text)));

/** What a cloud is like. @param {import("./cloud.js").Cloud} cloud */
export function tellFacts(cloud) {
  const { points, sent, least, greatest, format, crs } = cloud.head;
  const rows = [
    ["Points", sent < points ? `${whole(points)}, ${whole(sent)} of them shown` : whole(points)],
    ["Extent", greatest.map((end, axis) => measure(end - least[axis])).join(" × ")],
    ["Format", format],
    ...crs ? [["System", crs]] : [],
    ["Spacing", `about ${measure(cloud.spacing())}`],
  ];
  byId("facts").replaceChildren(...rows.flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, value)]));
}

/** Asks for a key, and goes on when there is one. */
export function askForKey(goOn) {
  const dialog = byId("ask-key");
  if (dialog.open) return;
  dialog.showModal();
  dialog.onclose = () => {
    keepKey(byId("key").value);
    say("");
    goOn();
  };
}
