/** Fields of the page's own numbers, which no server checks: what is none gives way to the last that was. */

import { publish } from "./store.js";

/** Watch a field; returns a function that returns its number, also while another one is being typed. */
export function amount(input) {
  let last = input.value;
  const valid = () => input.value !== "" && input.checkValidity();
  const settle = () => {
    if (valid() && input.value !== last) publish("accepted");
    if (valid()) last = input.value;
    else if (input.value !== last) giveBack();
  };
  const giveBack = () => {
    const expected = `a number, ${input.min} or above`;
    publish("notice", { what: `No ${input.ariaLabel}: ${last} is kept.`, expected });
    input.value = last;
  };
  input.addEventListener("change", settle);
  input.addEventListener("blur", settle);
  return () => Number(valid() ? input.value : last);
}
