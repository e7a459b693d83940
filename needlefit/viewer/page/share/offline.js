/** In a file there is no program: nothing is sent, nothing is undone, and no slice of a scan is shown. */

export const command = () => null;
export const newGesture = () => 0;
export const slice = () => null;
