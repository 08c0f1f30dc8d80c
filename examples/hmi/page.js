// A page of your own: tandem.js sends the commands and shows the answers; elements show the machine.

import { Refusal, Tandem } from "/tandem.js";

const machine = new Tandem({ name: "example" }).connect();
const said = /** @type {HTMLElement} */ (document.querySelector("#said"));

machine.on("cs/1/state", (state) => {
  document.title = `Mill: ${state.execution}`;
});

for (const button of document.querySelectorAll("button")) {
  button.addEventListener("click", async () => {
    try {
      await machine.command(1, /** @type {"start"} */ (button.dataset.verb));
      said.textContent = "";
    } catch (error) {
      if (!(error instanceof Refusal)) throw error;
      said.textContent = error.message;
    }
  });
}

document.addEventListener("tandem-refused", (event) => {
  said.textContent = /** @type {CustomEvent<string>} */ (event).detail;
});
