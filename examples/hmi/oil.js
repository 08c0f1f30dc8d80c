// A card of the panel Machine: strokes of the oil pump, counted by the sequence program in P100, and the rest of 500.

const STROKES_MAX = 500;

/**
 * @param {HTMLElement} element where the card is drawn
 * @param {{tandem: import("../../web/tandem.js").Tandem, cs: () => number}} screen the machine, and the coordinate system on the screen
 */
export default function oil(element, { tandem }) {
  const bar = document.createElement("meter");
  bar.max = STROKES_MAX;
  bar.low = STROKES_MAX / 5;
  bar.setAttribute("aria-label", "Oil that is left");
  const text = document.createElement("p");
  element.append(bar, text);
  const read = async () => {
    const { values } = await tandem.get("/variables/p?from=100&count=1").catch(() => ({ values: [] }));
    const left = STROKES_MAX - Number(values[0] ?? 0);
    bar.value = left;
    text.textContent = `${left} strokes left`;
  };
  void read();
  // the program that counts them resets an M code after each stroke of the pump
  tandem.on("cs/+/m_code/pending", () => void read());
}
