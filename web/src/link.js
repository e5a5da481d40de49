// A view as a link's fragment: where the camera is and what it shows, in the file's own coordinates.

const numbers = (text, count) => {
  const found = (text || "").split(",").map(part => part === "" ? NaN : Number(part));
  return found.length === count && found.every(Number.isFinite) ? found : null;
};

/** What can be up. */
const UPS = ["z", "y", "-y", "x"];

/** @typedef {{from: number[], to: number[], up: string, colour: string, compare: string, split: number, size: number,
 *    box: number[]|null, job: string|null, file: string|null}} Kept */

/** @param {Kept} kept */
export function fragmentOf(kept) {
  const fields = new URLSearchParams();
  const list = values => values.map(value => +value.toPrecision(12)).join(",");
  if (kept.job) fields.set("job", kept.job);
  if (kept.file) fields.set("file", kept.file);
  fields.set("from", list(kept.from));
  fields.set("to", list(kept.to));
  fields.set("up", kept.up);
  fields.set("colour", kept.colour);
  fields.set("compare", kept.compare);
  fields.set("split", kept.split.toFixed(3));
  fields.set("size", String(kept.size));
  if (kept.box) fields.set("box", list(kept.box));
  return fields.toString().replaceAll("%2C", ",");
}

/** What a fragment keeps; what is missing or broken in it is absent. @returns {Partial<Kept> & {key: string|null}} */
export function keptIn(fragment) {
  const fields = new URLSearchParams(fragment.replace(/^#/, ""));
  const up = fields.get("up") || "", from = numbers(fields.get("from"), 3);
  return {
    key: fields.get("key"),
    job: fields.get("job"),
    file: fields.get("file"),
    from: from || undefined,
    to: (from && numbers(fields.get("to"), 3)) || undefined,
    up: UPS.includes(up) ? up : undefined,
    colour: fields.get("colour") || undefined,
    compare: fields.get("compare") || undefined,
    split: numbers(fields.get("split"), 1)?.[0],
    size: numbers(fields.get("size"), 1)?.[0],
    box: numbers(fields.get("box"), 6),
  };
}
