// The connection to the server. A wish is sent, a frame comes back: never more than one is on its way, so a page
// that draws slowly is sent less.

const AGAIN = 1000; // ms until a lost connection is tried again

export function connect({ onFrame, onSaid, onState }) {
  let socket = null;
  let waiting = false; // for a frame

  function open() {
    socket = new WebSocket(`ws://${location.host}/stream`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => { waiting = false; onState(true); };
    socket.onclose = () => { onState(false); setTimeout(open, AGAIN); };
    socket.onmessage = ({ data }) => {
      if (typeof data === "string") { onSaid(JSON.parse(data)); return; }
      waiting = false;
      onFrame(decode(data));
    };
  }

  open();
  return {
    get ready() { return socket.readyState === WebSocket.OPEN && !waiting; },
    wish(wish) { waiting = true; socket.send(JSON.stringify({ wish })); },
    command(run, command, text) {
      if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ run, command, text }));
    },
  };
}

// The length of the head (4 bytes), the head as JSON, then the series, each two float32 for every column.
export function decode(buffer) {
  const size = new DataView(buffer).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size)));
  const values = new Map();
  const length = 2 * (head.columns ?? 0);
  (head.series ?? []).forEach((key, place) => {
    values.set(key, new Float32Array(buffer, 4 + size + 4 * length * place, length));
  });
  return { head, values, bytes: buffer.byteLength };
}
