/** The bevel's strength under the scene's rule of advance: b, or the angle of the cut. */

const OFFSET = { key: "offset_mm", symbol: "b", unit: "mm", digits: 3, step: 0.005 };
const ANGLE = { key: "cut_angle_deg", symbol: "θ", unit: "°", digits: 2, step: 0.1 };
const INPUTS = {
  offset_mm: ["bevel_offset_mm", "offset_throughout_mm"],
  cut_angle_deg: ["cut_angle_deg", "cut_angle_throughout_deg"],
};

/** How the strength is called, written and stepped, its inputs from here on and throughout, given what has it. */
export function strengthOf(values) {
  const about = "cut_angle_deg" in values ? ANGLE : OFFSET;
  const [here, throughout] = INPUTS[about.key];
  return { ...about, here, throughout, value: values[about.key] };
}
