/** In a file there is no program, and the needle is steered at once: nothing is sent, and nothing is undone. */

import { publish } from "../store.js";

export const change = (set) => publish("steered", set);
export const command = () => null;
export const newGesture = () => 0;
