/** Encodes pictures (ImageData of one size) as an animated GIF, which plays for ever. */

const COLOURS = 256;
const BITS = 5; // of a channel, by which colours are distinguished
const keyOf = (r, g, b) => ((r >> (8 - BITS)) << (2 * BITS)) | ((g >> (8 - BITS)) << BITS) | (b >> (8 - BITS));

/** The most frequent colours of some pictures, and the nearest of them to every colour, by its key. */
function choosePalette(pictures) {
  const size = 1 << (3 * BITS);
  const [counts, sums] = [new Uint32Array(size), new Float64Array(3 * size)];
  for (const { data } of pictures) {
    for (let i = 0; i < data.length; i += 4) {
      const key = keyOf(data[i], data[i + 1], data[i + 2]);
      counts[key] += 1;
      for (let c = 0; c < 3; c += 1) sums[3 * key + c] += data[i + c];
    }
  }
  const mean = (key) => [0, 1, 2].map((c) => sums[3 * key + c] / counts[key]);
  const keys = [...counts.keys()].filter((key) => counts[key]).sort((one, other) => counts[other] - counts[one]);
  const colours = keys.slice(0, COLOURS).map(mean);
  const nearest = new Uint8Array(size);
  keys.forEach((key, n) => {
    const [r, g, b] = mean(key);
    let least = Infinity;
    if (n < COLOURS) nearest[key] = n;
    else colours.forEach(([r2, g2, b2], i) => {
      const distance = (r - r2) ** 2 + (g - g2) ** 2 + (b - b2) ** 2;
      if (distance < least) [least, nearest[key]] = [distance, i];
    });
  });
  return { colours: colours.map((one) => one.map(Math.round)), nearest };
}

/** A list of bytes that grows. */
class Bytes {
  data = new Uint8Array(1 << 20);
  length = 0;
  add(...values) {
    if (this.length + values.length > this.data.length) {
      const more = new Uint8Array(2 * this.data.length);
      more.set(this.data);
      this.data = more;
    }
    for (const value of values) this.data[this.length++] = value;
  }
  short(value) {
    this.add(value & 255, value >> 8);
  }
}

/** Add the pixels of a picture, compressed (LZW, codes of 9 to 12 bits in blocks of at most 255 bytes). */
function compress(bytes, pixels) {
  const [clear, end, last] = [256, 257, 4095];
  const table = new Int16Array(4096 * 256); // the code of a known sequence and one pixel more
  const used = []; // its entries that are set
  let [bits, next, held, count, block] = [9, 258, 0, 0, []];
  const put = (code) => {
    held |= code << count;
    count += bits;
    while (count >= 8) {
      block.push(held & 255);
      held >>= 8;
      count -= 8;
      if (block.length === 255) (bytes.add(255, ...block), (block = []));
    }
  };
  bytes.add(8);
  put(clear);
  let sequence = pixels[0];
  for (let i = 1; i < pixels.length; i += 1) {
    const at = (sequence << 8) | pixels[i];
    if (table[at]) {
      sequence = table[at];
      continue;
    }
    put(sequence);
    if (next > last) {
      put(clear);
      for (const one of used) table[one] = 0;
      [bits, next, used.length] = [9, 258, 0];
    } else {
      if (next === 1 << bits) bits += 1;
      table[at] = next++;
      used.push(at);
    }
    sequence = pixels[i];
  }
  put(sequence);
  put(end);
  if (count) block.push(held & 255);
  if (block.length) bytes.add(block.length, ...block);
  bytes.add(0);
}

/** Return the GIF; `seconds` are how long each picture is seen. Other work goes on between two pictures. */
export async function encodeGif(pictures, seconds) {
  const [{ width, height }] = pictures;
  const { colours, nearest } = choosePalette(pictures);
  const bytes = new Bytes();
  bytes.add(...new TextEncoder().encode("GIF89a"));
  bytes.short(width);
  bytes.short(height);
  bytes.add(0xf7, 0, 0); // 256 colours for all pictures
  for (let i = 0; i < COLOURS; i += 1) bytes.add(...(colours[i] ?? [0, 0, 0]));
  bytes.add(0x21, 0xff, 11, ...new TextEncoder().encode("NETSCAPE2.0"), 3, 1, 0, 0, 0);
  for (const [n, { data }] of pictures.entries()) {
    bytes.add(0x21, 0xf9, 4, 4);
    bytes.short(Math.round(100 * seconds[n]));
    bytes.add(0, 0, 0x2c, 0, 0, 0, 0);
    bytes.short(width);
    bytes.short(height);
    bytes.add(0);
    const pixels = new Uint8Array(data.length / 4);
    for (let i = 0; i < pixels.length; i += 1) pixels[i] = nearest[keyOf(data[4 * i], data[4 * i + 1], data[4 * i + 2])];
    compress(bytes, pixels);
    await new Promise((done) => setTimeout(done));
  }
  bytes.add(0x3b);
  return new Blob([bytes.data.subarray(0, bytes.length)], { type: "image/gif" });
}
