/** Of a shared file: it holds no scan. */

export const slice = () => null;
