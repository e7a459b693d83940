/** Of a shared file: there is no program to talk to. */

export const needle = () => null;
export const send = () => null;
export const open = () => {};
export const receive = () => {};
export const answered = () => null;
