// Columns of numbers packed by packing.py: value = low + step * code, codes of 16 bits, little endian, base64.

function unpack({ rows, columns }) {
  const unpacked = {};
  for (const [name, [low, step, text]] of Object.entries(columns)) {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    unpacked[name] = Float64Array.from({ length: rows }, (_, k) => low + (text ? step * (bytes[2 * k] + 256 * bytes[2 * k + 1]) : 0));
  }
  return unpacked;
}
