/** The picture's colours, as the style sheet names them for light and for dark. */

const NAMES = [
  "air", "gutter", "ink", "quiet", "grid", "edge", "needle", "points", "path", "tip", "guide", "load",
  "measured", "band", "plan", "reach", "gap", "bad", "halo", "soft", "stiff", "label", "accent",
];

/** Colours by name; read anew when the reader's scheme changes. */
export const palette = {};

/** Read the colours from the style sheet. */
export function readPalette() {
  const style = getComputedStyle(document.documentElement);
  for (const name of NAMES) palette[name] = style.getPropertyValue(`--${name}`).trim();
}

/** One colour a layer: the stiffer, the darker, over one decade at least. */
export function shades(layers) {
  const stiffness = layers.map(({ mu_pa: mu }) => Math.log10(mu));
  const least = Math.min(...stiffness);
  const decades = Math.max(Math.max(...stiffness) - least, 1);
  return stiffness.map((one) => between(palette.soft, palette.stiff, (one - least) / decades));
}

function between(one, other, share) {
  const parts = [1, 3, 5].map((at) => {
    const [low, high] = [one, other].map((colour) => parseInt(colour.slice(at, at + 2), 16));
    return Math.round(low + share * (high - low));
  });
  return `rgb(${parts.join(" ")})`;
}
