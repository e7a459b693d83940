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
const room = (box) => new Uint8Array(box, HEAD);

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

/** Write bytes from a place on; beyond the end it goes on at the beginning. */
function write(box, at, bytes) {
  const from = (at >>> 0) % SIZE;
  const fits = Math.min(bytes.length, SIZE - from);
  room(box).set(bytes.subarray(0, fits), from);
  room(box).set(bytes.subarray(fits), 0);
}

function read(box, at, length) {
  const from = (at >>> 0) % SIZE;
  const fits = Math.min(length, SIZE - from);
  const bytes = new Uint8Array(length);
  bytes.set(room(box).subarray(from, from + fits));
  bytes.set(room(box).subarray(0, length - fits), fits);
  return bytes;
}
