// The packed data of the page: a header, and typed arrays by name (see report/player/packing.py).
const ARRAY_TYPES = { f4: Float32Array, i1: Int8Array, i2: Int16Array, u2: Uint16Array, u4: Uint32Array };

async function unpackPayload(text) {
  const letters = atob(text.trim());
  const packed = new Uint8Array(letters.length);
  for (let k = 0; k < letters.length; k++) packed[k] = letters.charCodeAt(k);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const content = new Uint8Array(await new Response(stream).arrayBuffer());
  const length = new DataView(content.buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(content.subarray(4, 4 + length)));
  let start = 4 + length;
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
  return { header, arrays };
}
