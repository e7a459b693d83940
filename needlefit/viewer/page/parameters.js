/** The parameters of a scene's model, from which fields are made. */

import { modulusLike } from "./quantities.js";

/** Of each layer its modulus, then the shape parameters of its law: {input, item, into: the list of fields, about: as of makeField}. */
export const listParameters = ({ layer_names: names, limits, fitted, shape_parameters: shapes }) => fitted.layers.flatMap((layer, i) => {
  const called = names[i] || `layer ${i + 1}`;
  const modulus = { ...modulusLike(layer.mu_pa), name: `μ ${called}`, symbol: "μ", logarithmic: true, step: 1.05, limits: limits.mu_pa };
  return [{ input: "mu_pa", item: i + 1, into: "tissue-fields", about: modulus }, ...shapes.map(({ name, symbol, unit }) => {
    const step = Math.min(0.1, (limits[name][1] - limits[name][0]) / 100);
    const about = { name: `${symbol} ${called}`, symbol, unit, step, write: (value) => value.toFixed(2), limits: limits[name] };
    return { input: name, item: i + 1, into: "shape-fields", about };
  })];
});
