/** What the page is given, and what it knows: lengths mm, moduli Pa, forces N, angles degrees unless named otherwise. */

import type { SteeredNeedle } from "./model/steered.js";
import type { Replay } from "./stored.js";

export type Change = [name: string, item: number | null, value: number];
export type Curve = { x: number[]; y: number[]; z?: number[] | null };
export type Errors = { upto_mm: number; whole: boolean; floor_mm: number | null } & { [metric: string]: any };

export type Guide = { x: number; y: number; slope: number | null; name: string };
export type Bevel = { side: number; roll: number; offset: number; cutAngle: number };
export type Controls = {
  baseY: number; baseSlope: number; stageSlope: number; guides: Guide[];
  tip: { y: number; slope: number | null; z?: number } | null;
};
export type Step = { depth: number; bevel: Bevel; controls: Controls };

/** A layer by the names of its inputs: `mu_pa`, and the shape parameters of its law. */
export type Layer = { [input: string]: number };
export type Model = {
  spatial: boolean; length: number; rigidity: number; boundaries: number[]; terms: number;
  mu: number[]; thickness: number[]; friction: number[]; law: number[];
  spacing: number; element: number; firstCell: number; pathAngle: boolean;
  switch: number; tangent: number; tolerance: number; maxIterations: number;
};

export type Measured = Curve & {
  id: string; depth_mm: number; s: number[]; floor_mm: number | null;
  compared: "plane" | "space"; metrics: [name: string, label: string, unit: string, text: string][];
  prediction: (Curve & { errors: Errors }) | null;
  target: Required<Curve> & { pose: "known" | "direction" | "free"; s: number[]; z: number[] };
  stored?: Required<Curve>;
};
export type Plan = {
  target: [number, number]; radius: number;
  obstacles: [x: number, y: number, radius: number, name: string][]; needles: [number[], number[]][];
};

/** All of a needle that does not change while it is steered. */
export type Scene = {
  kind: "scene"; title: string; origin_mark: string; length_mm: number; depth_mm: number; diameter_mm: number;
  spacing_mm: number; first_cell_mm: number; layer_names: string[]; guide_names: string[]; boundaries_mm: number[];
  shape_parameters: { name: string; symbol: string; unit: string; explanation: string }[];
  definitions: { [symbol: string]: string };
  fitted: { layers: Layer[]; offset_mm?: number; cut_angle_deg?: number };
  limits: { [input: string]: any; depth_mm: number };
  simulation: { model: Model; shape: number[][]; law: any; steps: Step[]; changes: Change[][]; rules: any };
  measured: Measured | null; plan: Plan | null;
  draws: { sets: number; mu: number[]; law: number[]; strength: number[] } | null;
};

/** A needle of the file. */
export type Needle = {
  scene: Scene; head?: string; name?: string; group?: string; new_specimen?: boolean; tip: number | null;
  recording?: [time: number, changes: Change[], tip: number][];
  errors?: { [metric: string]: number }; // of the run
};

/** All of a needle that changes from step to step; `z` of a needle in space. */
export type State = {
  kind: "state"; step: number; depth_mm: number; x: number[]; y: number[]; z: number[] | null;
  base: { x: number; y: number; rotation: number; input_y: number; input_slope: number };
  guides: { item: number; name: string; x: number; y: number; slope: number; turns_freely: boolean }[];
  tip: { x: number; y: number; z: number | null; rotation: number; lateral_mm: number; held: boolean; input_y: number };
  bevel: { side: number; roll_deg: number; offset_mm?: number; cut_angle_deg?: number };
  layers: Layer[]; max_slope: number; faults: string[]; errors: Errors | null;
};

export type Band = { kind: "band"; step: number; x: number[]; low: number[]; high: number[]; z: { low: number[]; high: number[] } | null };
/** Left, top, width and height, px. */
export type Place = [number, number, number, number];
export type Box = { left: number; top: number; width: number; height: number };
export type View = {
  x: number; y: number; scale: number; magnified: number; fit: string; of: Scene | null; box: Box;
};

/** What the page knows; from `data` to `state` all is there once a needle is shown. */
export type Now = {
  data: { needles: Needle[]; kernel: WebAssembly.Module; title?: string; needlefit: string };
  needle: Needle; steered: SteeredNeedle; scene: Scene; state: State; view: View;
  replay: Replay | null; band: Band | null; shown: { [layer: string]: boolean }; labels: Place[]; avoided: Place[];
};
