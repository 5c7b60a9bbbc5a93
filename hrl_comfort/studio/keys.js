// Walking keys: W, A, S, D walk and Q, E turn the person instead of moving the camera.
(() => {
  const KEYS = { KeyW: "w", KeyA: "a", KeyS: "s", KeyD: "d", KeyQ: "q", KeyE: "e" };
  const held = new Set();
  let beat = null;
  const send = () => fetch("/studio/keys?held=" + [...held].join(""), { method: "GET" }).catch(() => {});
  const changed = () => {
    send();
    clearInterval(beat);
    beat = held.size ? setInterval(send, 200) : null;
  };
  const typing = (target) => target.closest && target.closest("input, textarea, select, [contenteditable=true]");
  const onKey = (event) => {
    const key = KEYS[event.code];
    if (!key || event.ctrlKey || event.metaKey || event.altKey || typing(event.target)) return;
    event.stopImmediatePropagation();
    event.preventDefault();
    const had = held.has(key);
    event.type === "keydown" ? held.add(key) : held.delete(key);
    if (had !== held.has(key)) changed();
  };
  window.addEventListener("keydown", onKey, true);
  window.addEventListener("keyup", onKey, true);
  window.addEventListener("blur", () => {
    if (held.size) {
      held.clear();
      changed();
    }
  });
})();
