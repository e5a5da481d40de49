// Points as the server packs them: a head in JSON, then blocks of little-endian numbers (docs/http.md).

const MAGIC = 0x31504344; // "DCP1"

/**
 * @typedef {{name: string, role: string|null, least: number, greatest: number}} Column
 * @typedef {{points: number, sent: number, anchor: number[], least: number[], greatest: number[], colours: boolean,
 *   columns: Column[], format: string, crs?: string, warnings: string[]}} Head
 * @typedef {{count: number, positions: Float32Array, colours: Uint8Array|null, columns: Float32Array[]}} Block
 */

/** Bytes of a stream, as many at a time as are asked for. */
class Bytes {
  /** @param {ReadableStreamDefaultReader<Uint8Array>} reader */
  constructor(reader) {
    this.reader = reader;
    /** @type {Uint8Array} */
    this.piece = new Uint8Array(0);
  }

  /** Fills an array; false where the stream ends before its first byte. */
  async fill(into) {
    let filled = 0;
    while (filled < into.length) {
      if (this.piece.length === 0) {
        const { done, value } = await this.reader.read();
        if (done && filled === 0) return false;
        if (done) throw new Error("the answer breaks off");
        this.piece = value;
      }
      const taken = this.piece.subarray(0, into.length - filled);
      into.set(taken, filled);
      filled += taken.length;
      this.piece = this.piece.subarray(taken.length);
    }
    return true;
  }

  async take(length) {
    const bytes = new Uint8Array(length);
    if (length > 0 && !await this.fill(bytes)) throw new Error("the answer breaks off");
    return bytes;
  }
}

/** Bytes of a point. */
const rowOf = head => 12 + (head.colours ? 4 : 0) + 4 * head.columns.length;

/** A block's parts, none of which is a copy. @returns {Block} */
function blockOf(head, count, buffer) {
  let at = 0;
  const next = (Kind, length) => {
    const part = new Kind(buffer, at, length);
    at += part.byteLength;
    return part;
  };
  const positions = next(Float32Array, 3 * count);
  const colours = head.colours ? next(Uint8Array, 4 * count) : null;
  const columns = head.columns.map(() => next(Float32Array, count));
  return { count, positions, colours, columns };
}

/**
 * Reads an answer: its head, then its blocks while they come.
 * @param {ReadableStream<Uint8Array>} body
 * @returns {Promise<{head: Head, blocks: AsyncGenerator<Block>}>}
 */
export async function unpack(body) {
  const bytes = new Bytes(body.getReader());
  const [magic, length] = new Uint32Array((await bytes.take(8)).buffer);
  if (magic !== MAGIC) throw new Error("the answer is no packed cloud");
  const head = JSON.parse(new TextDecoder().decode(await bytes.take(length)));
  return { head, blocks: blocksOf(head, bytes) };
}

async function* blocksOf(head, bytes) {
  let left = head.sent;
  while (left > 0) {
    const [count] = new Uint32Array((await bytes.take(4)).buffer);
    if (count === 0 || count > left) throw new Error("the answer's blocks do not fit its head");
    left -= count;
    yield blockOf(head, count, (await bytes.take(count * rowOf(head))).buffer);
  }
}
