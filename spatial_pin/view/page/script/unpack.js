// Unpacks what the page holds packed, nine tenths of it, and runs it.
const BROWSERS = "Chrome or Edge 103, Firefox 113, Safari 16.4";  // the first that can
const heldIn = id => JSON.parse(document.getElementById(id).textContent);
var film = heldIn("film");

async function unpacked({sizes, packed}) {  // pieces of data
  const unpacker = new DecompressionStream("deflate-raw"), writer = unpacker.writable.getWriter();
  writer.write(Uint8Array.from(atob(packed), c => c.charCodeAt(0)));
  writer.close();
  const all = new Uint8Array(await new Response(unpacker.readable).arrayBuffer());
  let end = 0;
  return sizes.map(one => all.slice(end, end += one));
}

async function begin() {
  for (const name of ["commands", "extras"]) film[name] = await unpacked(film[name]);
  film.values = (await unpacked(film.signals.held)).map(one => new Float32Array(one.buffer));
  for (const id of ["meshcat", "script"]) {
    const [text] = await unpacked(heldIn(id));
    document.head.appendChild(document.createElement("script")).textContent = new TextDecoder().decode(text);
  }
}

begin().catch(error => {
  document.getElementById("alarms").textContent = `This page needs a newer browser (${BROWSERS}): ${error.message}`;
  throw error;
});
