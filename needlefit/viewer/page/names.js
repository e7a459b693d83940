/** What guides are called. */

/** The name of a guide that its scene gives none. */
export const numbered = (item) => `guide ${item}`;

/** What is written beside a guide in the picture: its scene's name for it, or its number alone. */
export const shortName = ({ item, name }) => (name && name !== numbered(item) ? name : String(item));
