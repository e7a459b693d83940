/** The needle of the address, and the address of the needle. */

import { nameIn, readAddress, writeAddress } from "./address.js";
import { element, part, press, write } from "./dom.js";
import { ModelError } from "./model/inputs.js";
import { refuse, steer } from "./steering.js";
import { now } from "./store.js";

/** @type {(needle: Needle) => string} */
export const nameOf = ({ name, scene }) => name ?? scene.measured?.id ?? scene.title;

/** Give the reader a file named as the needle. @param {BlobPart} content @param {string} type @param {string} ending */
export function save(content, type, ending) {
  const name = `${nameOf(now.needle).replace(/[^\w-]+/g, "-")}.${ending}`;
  const link = /** @type {HTMLAnchorElement} */ (element("a", { href: URL.createObjectURL(new Blob([content], { type })), download: name }));
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
  return name;
}

/** Show the needle of the address; resolves to whether it has one. The place of another part of a report is none. @param {(number: number) => Promise<void>} choose */
export async function followAddress(choose) {
  const address = location.hash.slice(1);
  if (!address || document.querySelector(":target")) return false;
  const { needles } = now.data;
  const below = part("proof").parentElement;
  try {
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
