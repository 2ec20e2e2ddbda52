// The packed data of the page: a header, and typed arrays by name (see view/player/compression.py).
const ARRAY_TYPES = { f4: Float32Array, i1: Int8Array, i2: Int16Array, u1: Uint8Array, u2: Uint16Array, u4: Uint32Array };

/** @param {string} text @returns {Promise<Payload>} */
async function unpackPayload(text) {
  const letters = atob(text.trim());
  const packed = new Uint8Array(letters.length);
  for (let k = 0; k < letters.length; k++) packed[k] = letters.charCodeAt(k);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const content = new Uint8Array(await new Response(stream).arrayBuffer());
  const length = new DataView(content.buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(content.subarray(4, 4 + length)));
  let start = 4 + length;
  /** @type {any} */
  const arrays = {};
  for (const { name, type, shape } of header.arrays) {
    const count = shape.reduce((a, b) => a * b, 1), numbers = new ARRAY_TYPES[type](count);
    const bytes = new Uint8Array(numbers.buffer), size = numbers.BYTES_PER_ELEMENT;
    for (let place = 0; place < size; place++) {
      for (let k = 0, to = place; k < count; k++, to += size) bytes[to] = content[start + k];
      start += count;
    }
    arrays[name] = numbers;
  }
  for (const name of header.predicted) addPredictions(arrays[name], arrays.faces, arrays.lack.length / 3);
  return { header, arrays };
}

// Undoes `Predictor` of view/player/compression.py in rows of `count` numbers. Arrays
// of 16 bits begin again where sums are too large.
function addPredictions(values, faces, count) {
  const starts = new Uint32Array(count + 2), before = new Uint32Array(2 * faces.length), lack = new Int16Array(count);
  const visit = (action) => faces.forEach((vertex, k) => {
    for (const other of faces.subarray(k - k % 3, k - k % 3 + 3)) if (other < vertex) action(vertex, other);
  });
  visit((vertex) => { starts[vertex + 2]++; });
  for (let j = 2; j < starts.length; j++) starts[j] += starts[j - 1];
  visit((vertex, other) => { before[starts[vertex + 1]++] = other; });
  for (let row = 0; row < values.length; row += count) for (let j = 0; j < count; j++) {
    const from = starts[j], to = starts[j + 1], near = to - from || 1, code = values[row + j] & 65535;
    let sum = 0, lacks = 0;
    for (let k = from; k < to; k++) { sum += values[row + before[k]]; lacks += lack[before[k]]; }
    if (from === to && j) { sum = values[row + j - 1]; lacks = lack[j - 1]; }
    lack[j] = (floor(lacks / near) >> 1) + (code >> 1 ^ -(code & 1));
    values[row + j] = floor(sum / near) + lack[j];
  }
}
