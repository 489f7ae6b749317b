// Shortcuts: single keys, but never while something is typed, nor with a modifier of the browser's.

const TYPED = "input:not([type=checkbox]), select, textarea";

export function onKeys(actions) {
  document.addEventListener("keydown", (event) => {
    if (event.key === "Escape") { document.activeElement?.blur(); return; }
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest?.(TYPED)) return;
    const action = actions[event.key];
    if (!action) return;
    event.preventDefault();
    action();
  });
}
