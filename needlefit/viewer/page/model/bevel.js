/** The roll of a bevel about x, degrees: 0 toward +y, 90 toward +z. */

/** The roll of a bevel; 180 where its side is -1. @param {{ side: number, roll: number }} bevel */
export const rollOf = ({ side, roll }) => roll + (side > 0 ? 0 : 180);

/** A roll between -180, which it is not, and 180 degrees. @param {number} roll */
export const wrap = (roll) => 180 - ((((180 - roll) % 360) + 360) % 360);

/** The change that turns over a bevel with a roll. @param {number} roll @returns {Change} */
export const turnOver = (roll) =>
  roll % 180 ? ["bevel_roll_deg", null, wrap(roll + 180)] : ["bevel_side", null, roll % 360 ? 1 : -1];
