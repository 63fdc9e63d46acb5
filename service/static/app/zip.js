/** ZIP archives without compression: pictures are compressed already. */

const CRC_TABLE = Uint32Array.from({ length: 256 }, (_, byte) => {
  let rest = byte;
  for (let bit = 0; bit < 8; bit++) rest = rest & 1 ? (rest >>> 1) ^ 0xedb88320 : rest >>> 1;
  return rest >>> 0;
});

function crcOf(bytes) {
  let crc = 0xffffffff;
  for (const byte of bytes) crc = CRC_TABLE[(crc ^ byte) & 0xff] ^ (crc >>> 8);
  return (crc ^ 0xffffffff) >>> 0;
}

/** Little-endian numbers of [size in bytes, value]. */
function numbers(...fields) {
  const view = new DataView(new ArrayBuffer(fields.reduce((sum, [size]) => sum + size, 0)));
  let at = 0;
  for (const [size, value] of fields) {
    if (size === 2) view.setUint16(at, value, true);
    else view.setUint32(at, value, true);
    at += size;
  }
  return new Uint8Array(view.buffer);
}

const VERSION = 20;
/** 1 January 1980, the first day that the format knows. */
const DAY = 0x21;

/**
 * @param {[string, Blob][]} files names in ASCII, and contents
 * @returns {Promise<Blob>}
 */
export async function zipped(files) {
  const parts = [];
  const entries = [];
  let offset = 0;
  for (const [name, blob] of files) {
    const label = new TextEncoder().encode(name);
    const bytes = new Uint8Array(await blob.arrayBuffer());
    const about = [
      [2, VERSION], [2, 0], [2, 0], [2, 0], [2, DAY], [4, crcOf(bytes)],
      [4, bytes.length], [4, bytes.length], [2, label.length], [2, 0],
    ];
    const head = numbers([4, 0x04034b50], ...about);
    parts.push(head, label, bytes);
    const place = [[2, 0], [2, 0], [2, 0], [4, 0], [4, offset]];
    entries.push(numbers([4, 0x02014b50], [2, VERSION], ...about, ...place), label);
    offset += head.length + label.length + bytes.length;
  }
  const size = entries.reduce((sum, { length }) => sum + length, 0);
  const count = files.length;
  const end = numbers(
    [4, 0x06054b50], [2, 0], [2, 0], [2, count], [2, count], [4, size], [4, offset], [2, 0],
  );
  return new Blob([...parts, ...entries, end], { type: "application/zip" });
}
