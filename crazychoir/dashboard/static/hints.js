// Show the hint of each tab until it is dismissed; the browser remembers that.
const STORED_PREFIX = "crazychoir.hint."; // of the keys in the storage of the browser

// Return what the browser has stored; null if the operator has forbidden it to store.
function stored() {
  try {
    return window.localStorage;
  } catch {
    return null;
  }
}

export function start() {
  for (const hint of document.querySelectorAll("[data-hint]")) {
    const key = STORED_PREFIX + hint.dataset.hint;
    hint.hidden = stored()?.getItem(key) === "dismissed";
    hint.querySelector("button").addEventListener("click", () => {
      hint.hidden = true;
      stored()?.setItem(key, "dismissed");
    });
  }
}
