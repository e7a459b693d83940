/** Numbers as they are written and read. */

/** With its sign, a true minus, and none at zero. */
export function signed(value, digits) {
  const size = Math.abs(value).toFixed(digits);
  if (Number(size) === 0) return size;
  return (value < 0 ? "−" : "+") + size;
}

/** A number of so many significant digits, without idle zeros, as a field holds it. */
export function brief(value, digits = 4) {
  return String(Number(Number(value).toPrecision(digits)));
}

/** Groups of three digits, apart by thin spaces. */
export function grouped(value) {
  return Math.round(value).toString().replace(/\B(?=(\d{3})+$)/g, "\u2009");
}

/** A modulus, Pa, as it is read: in MPa. */
export const asMpa = (pascal) => brief(pascal * 1e-6);
export const fromMpa = (text) => Number(text) * 1e6;

export const toDegrees = (rotation) => (rotation * 180) / Math.PI;
export const degrees = (slope) => (Math.atan(slope) * 180) / Math.PI;
export const slope = (angle) => Math.tan((Math.min(Math.max(angle, -90), 90) * Math.PI) / 180);

/** The nearest 1, 2 or 5 times a power of ten that is not greater. */
export function roundStep(value) {
  const decade = 10 ** Math.floor(Math.log10(value));
  const times = value / decade;
  return decade * (times >= 5 ? 5 : times >= 2 ? 2 : 1);
}
