/** The scan's slice that lies behind the needle. */

import { needle } from "./connection.js";
import { post } from "./requests.js";
import { listen, now, publish } from "./store.js";

let held = null; // {image, extent} of the scene it belongs to

/** The slice, its edges in mm (left, right, bottom, top), as {image, extent}, or null while there is none. */
export const slice = () => held;

listen("scene", async (scene) => {
  held = null;
  if (!scene.slice) return;
  try {
    const answer = await post("/slice", { needle: needle() });
    const image = await createImageBitmap(await answer.blob());
    if (now.scene !== scene) return; // another one is shown by now
    held = { image, extent: answer.headers.get("X-Extent-MM").split(",").map(Number) };
    publish("slice", held);
  } catch ({ what }) {
    publish("notice", { what: `No slice of the scan: ${what}` });
  }
});
