/** The needle of the address, and the address of the needle. */

import { nameIn, readAddress, writeAddress } from "./address.js";
import { part, press, write } from "./dom.js";
import { ModelError } from "./model/inputs.js";
import { refuse, steer } from "./steering.js";
import { now } from "./store.js";

/** @type {(needle: Needle) => string} */
export const nameOf = ({ name, scene }) => name ?? scene.measured?.id ?? scene.title;

/** Show the needle of the address; resolves to whether it has one. The place of another part of a report is none. @param {(number: number) => Promise<void>} choose */
export async function followAddress(choose) {
  const address = location.hash.slice(1);
  if (!address) return false;
  const { needles } = now.data;
  const below = part("proof").parentElement;
  try {
    if (part(decode(address))) return false;
    const name = nameIn(address);
    const number = needles.findIndex((one) => nameOf(one) === name);
    if (name !== null && number < 0) throw new ModelError(`the address has needle=${name}`, needles.map(nameOf).join(", "));
    if (number >= 0 && needles[number] !== now.needle) await choose(number);
    const lists = readAddress(address, now.scene);
    if (lists.length) steer(lists, { below, whole: true });
    return lists.length > 0;
  } catch (error) {
    refuse(error, below);
    return true;
  }
}

/** @param {string} address */
function decode(address) {
  try {
    return decodeURIComponent(address);
  } catch {
    throw new ModelError(`the address ends with #${address}, which is no text`, "depth=, in mm, as Copy link writes it");
  }
}

/** Copy the address of this file with the needle as it stands; of a needle that no address leads to, say so. */
async function copy() {
  const { data: { needles, kernel }, needle, scene, steered } = now;
  const address = await writeAddress(kernel, steered, needles.length > 1 ? nameOf(needle) : null);
  write("link-note", address ? "" : "No link: an address carries depth, roll and turns of the bevel, and parameters. A recording carries all inputs.");
  if (!address) return;
  steer(readAddress(address, scene)); // the same needle within the solver's tolerance: from now on to the bit
  history.replaceState(null, "", `#${address}`); // no change of the needle
  await navigator.clipboard?.writeText(location.href).then(() => write("link-note", "The link is copied."), () => null);
}

press("copy-link", copy);
