/**
 * Texts from one thread to another through shared memory.
 *
 * After a key is pressed a browser draws before it delivers messages. What lies in here is read at the
 * beginning of that very frame, so that the picture answers one frame sooner.
 */

const SIZE = 1 << 22; // bytes that may wait
const HEAD = 8; // bytes: how many were put, how many taken
const LENGTH = 4; // bytes before each text
const [PUT, TAKEN] = [0, 1];

/** Make one, or null where the browser shares no memory: the page must be isolated from others. */
export const makeMailbox = () => (globalThis.crossOriginIsolated ? new SharedArrayBuffer(HEAD + SIZE) : null);

const counts = (box) => new Int32Array(box, 0, 2);

/** Put a text in; returns whether there was room. */
export function put(box, text) {
  const bytes = new TextEncoder().encode(text);
  const count = counts(box);
  const at = Atomics.load(count, PUT);
  if (at - Atomics.load(count, TAKEN) + LENGTH + bytes.length > SIZE) return false;
  write(box, at, new Uint8Array(new Uint32Array([bytes.length]).buffer));
  write(box, at + LENGTH, bytes);
  Atomics.store(count, PUT, at + LENGTH + bytes.length);
  return true;
}

/** Take the oldest text out, or null. */
export function take(box) {
  const count = counts(box);
  const at = Atomics.load(count, TAKEN);
  if (at === Atomics.load(count, PUT)) return null;
  const [length] = new Uint32Array(read(box, at, LENGTH).buffer);
  const text = new TextDecoder().decode(read(box, at + LENGTH, length));
  Atomics.store(count, TAKEN, at + LENGTH + length);
  return text;
}

/** Where bytes from a place on lie; beyond the end they go on at the beginning. */
function parts(box, at, length) {
  const from = (at >>> 0) % SIZE;
  const fits = Math.min(length, SIZE - from);
  return [new Uint8Array(box, HEAD + from, fits), new Uint8Array(box, HEAD, length - fits)];
}

function write(box, at, bytes) {
  const [first, rest] = parts(box, at, bytes.length);
  first.set(bytes.subarray(0, first.length));
  rest.set(bytes.subarray(first.length));
}

function read(box, at, length) {
  const [first, rest] = parts(box, at, length);
  const bytes = new Uint8Array(length);
  bytes.set(first);
  bytes.set(rest, first.length);
  return bytes;
}
