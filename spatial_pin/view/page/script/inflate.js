// Unpacks what the page holds packed (RFC 1951): meshcat and the signs, three quarters of its size.
const LENGTHS = {base: [3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 15, 17, 19, 23, 27, 31, 35, 43, 51, 59, 67, 83, 99, 115, 131, 163, 195, 227, 258],
                 extra: [0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 0]};
const DISTANCES = {base: [1, 2, 3, 4, 5, 7, 9, 13, 17, 25, 33, 49, 65, 97, 129, 193, 257, 385, 513, 769, 1025, 1537, 2049, 3073, 4097, 6145, 8193, 12289, 16385, 24577],
                   extra: [0, 0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7, 8, 8, 9, 9, 10, 10, 11, 11, 12, 12, 13, 13]};
const ORDER = [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15];  // of the code's own lengths

function codeOf(lengths) {  // how many words there are of each length, and the symbols in their order
  const counts = new Uint16Array(16);
  for (const length of lengths) counts[length]++;
  counts[0] = 0;
  const symbols = [];
  for (let bits = 1; bits < 16; bits++) lengths.forEach((length, symbol) => { if (length === bits) symbols.push(symbol); });
  return {counts, symbols};
}

const FIXED = {
  letters: codeOf(Array.from({length: 288}, (_, k) => k < 144 ? 8 : k < 256 ? 9 : k < 280 ? 7 : 8)),
  distances: codeOf(Array(30).fill(5)),
};

class Unpacker {
  constructor(packed, size) {
    Object.assign(this, {packed, at: 0, bit: 0, out: new Uint8Array(size), end: 0});
    while (!this.block());
  }

  bits(count) {  // the lowest first
    let value = 0;
    for (let k = 0; k < count; k++) {
      value |= (this.packed[this.at] >> this.bit & 1) << k;
      if (++this.bit === 8) { this.bit = 0; this.at++; }
    }
    return value;
  }

  symbol({counts, symbols}) {
    let code = 0, first = 0, index = 0;
    for (let length = 1; length < 16; length++) {
      code |= this.bits(1);
      if (code - first < counts[length]) return symbols[index + code - first];
      index += counts[length];
      first = first + counts[length] << 1;
      code <<= 1;
    }
    throw new Error("this page is damaged");
  }

  block() {  // true after the last
    const [last, kind] = [this.bits(1), this.bits(2)];
    if (kind === 0) this.copy();
    else this.letters(kind === 1 ? FIXED : this.codes());
    return last;
  }

  copy() {
    const start = this.at + (this.bit ? 1 : 0) + 4;
    const size = this.packed[start - 4] | this.packed[start - 3] << 8;
    this.out.set(this.packed.subarray(start, start + size), this.end);
    this.end += size;
    [this.at, this.bit] = [start + size, 0];
  }

  codes() {
    const [letters, distances, own] = [this.bits(5) + 257, this.bits(5) + 1, this.bits(4) + 4];
    const lengths = Array(19).fill(0);
    for (let k = 0; k < own; k++) lengths[ORDER[k]] = this.bits(3);
    const code = codeOf(lengths), found = [];
    while (found.length < letters + distances) {
      const symbol = this.symbol(code);
      if (symbol < 16) found.push(symbol);
      else if (symbol === 16) this.repeat(found, found[found.length - 1], 3 + this.bits(2));
      else this.repeat(found, 0, symbol === 17 ? 3 + this.bits(3) : 11 + this.bits(7));
    }
    return {letters: codeOf(found.slice(0, letters)), distances: codeOf(found.slice(letters))};
  }

  repeat(found, length, times) {
    for (let k = 0; k < times; k++) found.push(length);
  }

  letters(code) {
    for (let symbol = this.symbol(code.letters); symbol !== 256; symbol = this.symbol(code.letters)) {
      if (symbol < 256) { this.out[this.end++] = symbol; continue; }
      const length = LENGTHS.base[symbol - 257] + this.bits(LENGTHS.extra[symbol - 257]);
      const far = this.symbol(code.distances);
      const away = DISTANCES.base[far] + this.bits(DISTANCES.extra[far]);
      for (let k = 0; k < length; k++, this.end++) this.out[this.end] = this.out[this.end - away];
    }
  }
}

function unpacked({sizes, packed}) {  // pieces of data
  const size = sizes.reduce((sum, one) => sum + one, 0);
  const all = new Unpacker(Uint8Array.from(atob(packed), c => c.charCodeAt(0)), size).out;
  let end = 0;
  return sizes.map(one => all.slice(end, end += one));
}

const [meshcat] = unpacked(JSON.parse(document.getElementById("meshcat").textContent));
document.head.appendChild(document.createElement("script")).textContent = new TextDecoder().decode(meshcat);
