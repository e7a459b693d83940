/** What the page is given, and what it knows: lengths mm, moduli Pa, forces N, angles degrees unless named otherwise. */

type Change = [name: string, item: number | null, value: number];
/** A number of an address: key, input, factors to the units of the input and of the model, value in the model. */
type AddressKey = [
  key: string, input: string, item: number | null, toInput: number, toModel: number,
  read: (needle: { inputs: Inputs; model: Model }) => number,
];
/** Changes that were carried out, where the tip then was, y, mm, and those before them. */
type Way = { changes: Change[]; tip: number; before: Way | null };
type Curve = { x: number[]; y: number[]; z?: number[] | null };
type Errors = { upto_mm: number; whole: boolean; floor_mm: number | null } & { [metric: string]: any };

type Guide = { x: number; y: number; slope: number | null; name: string };

/** A layer by the names of its inputs: `mu_pa`, and the shape parameters of its law. */
type Layer = { [input: string]: number };
type Model = {
  spatial: boolean; length: number; rigidity: number; boundaries: number[]; terms: number;
  mu: number[]; thickness: number[]; friction: number[]; law: number[];
  spacing: number; element: number; firstCell: number; pathAngle: boolean;
  switch: number; tangent: number; tolerance: number; maxIterations: number; shape: number[][];
};

// ---- the kernel: moduli MPa, slopes without unit

type Numbers = Float64Array | BigInt64Array | Uint8Array | Uint32Array;
/** `side` is +1 or -1, `roll` from there, degrees; `strength`: b, mm, or with `pathAngle` the cut angle, rad. Slope null: turns freely. */
type Inputs = {
  bevel: { side: number; roll: number; strength: number }; base: { y: number; slope: number; stageSlope: number };
  guides: Guide[]; tip: { y: number; slope: number | null; z?: number } | null;
};
type Session = import("../../mechanics/native/needle.js").Session;
type SteeredNeedle = import("./model/steered.js").SteeredNeedle;
type Reached = { depth: number; inputs: Inputs };
type Saved = { way: Way | null; session: ReturnType<Session["save"]> };
/** N nodes, base first: `u` and slope in each plane (planes * N); of each constraint point depth and place (1 + planes), and the tip's deflection and slope there (2 * planes). */
type Shape = {
  status: string; depth: number; planes: number;
  x: Float64Array; u: Float64Array; slope: Float64Array; constraints: Float64Array; track: Float64Array;
};

// ---- the file

type Pose = "known" | "direction" | "free";
type Measured = Curve & {
  id: string; depth_mm: number; s: number[]; floor_mm: number | null;
  compared: "plane" | "space"; metrics: [name: string, label: string, unit: string, text: string][];
  tip?: Curve & { z: number[] }; prediction: (Curve & { errors: Errors }) | null;
  target: { x: number[]; y: number[]; z: number[]; s: number[]; pose: Pose };
  stored?: { x: number[]; y: number[]; z: number[] };
};
type Plan = {
  target: [number, number]; radius: number;
  obstacles: [x: number, y: number, radius: number, name: string][]; needles: [number[], number[]][];
};
type Draws = { sets: number; mu: number[]; law: number[]; strength: number[]; gain?: number[] | null };

/** How an input is checked: `describe_input_rules` in Python. */
type InputRule = {
  item?: string; parameter?: boolean; expected?: string;
  least?: number; above?: number; upto?: number; below?: number; values?: number[];
};
type Rules = {
  inputs: { [name: string]: InputRule }; max_mm: number; max: number; max_guide: number; clearance_mm: number;
  validity: [name: string, limit: number, words: string][];
};
type Law = {
  terms: { at_zero: number[]; slopes: number[][]; layers: number } | null;
  tables: [shape: number[][], law: number[]][];
};

/** All of a needle that does not change while it is steered. */
type Scene = {
  title: string; origin_mark: string; length_mm: number; depth_mm: number; diameter_mm: number;
  spacing_mm: number; layer_names: string[]; guide_names: string[]; boundaries_mm: number[];
  shape_parameters: { name: string; symbol: string; unit: string; explanation: string }[];
  definitions: { [symbol: string]: string };
  fitted: Strength & { layers: Layer[] };
  limits: { [input: string]: any; depth_mm: number };
  simulation: { model: Model; law: Law; steps: Reached[]; changes: Change[][]; rules: Rules };
  measured: Measured | null; plan: Plan | null; draws: Draws | null;
};

type RecordedStep = [time: number, changes: Change[], tip: number];

/** A needle of the file. */
type Needle = {
  scene: Scene; head?: string; name?: string; group?: string; new_specimen?: boolean; tip: number | null;
  recording?: RecordedStep[];
  errors?: { [metric: string]: number }; // of the run
};

type ShownGuide = { item: number; name: string; x: number; y: number; slope: number; turns_freely: boolean };
/** How strongly a bevel turns the cut, by the rule of advance. */
type Strength = { offset_mm?: number; cut_angle_deg?: number };
type ShownBevel = Strength & { side: number; roll_deg: number };
/** All of a needle that changes from step to step; `z` of a needle in space. */
type State = {
  step: number; depth_mm: number; x: number[]; y: number[]; z: number[] | null;
  constraints: Curve; tip_path: Curve;
  base: { x: number; y: number; rotation: number; input_y: number; input_slope: number };
  guides: ShownGuide[];
  tip: { x: number; y: number; z: number | null; rotation: number; lateral_mm: number; held: boolean; input_y: number };
  bevel: ShownBevel; layers: Layer[]; max_slope: number; faults: string[]; errors: Errors | null;
};

type Band = { step: number; x: number[]; low: number[]; high: number[]; z: { low: number[]; high: number[] } | null };

// ---- the picture, px

type Point = [x: number, y: number];
type Scale = (value: number) => number;
type Place = [left: number, top: number, width: number, height: number];
type Box = { left: number; top: number; width: number; height: number };
type View = {
  x: number; y: number; scale: number; magnified: number; fit: "whole" | "tissue" | "tip" | "moved"; of: Scene | null; box: Box;
};
type Font = "small" | "plain" | "strong";
/** Colours by their names in the style. */
type Looks = { fill?: string; stroke?: string; width?: number; dash?: number[]; opacity?: number };
type TextLooks = { fill?: string; font?: Font; align?: "start" | "middle" | "end"; halo?: boolean };

type Shown = "measured" | "band" | "plan" | "pinned" | "errors" | "points" | "path" | "load" | "inset";

/** A field: the `symbol` by which it is defined, how a value is written, and what is written read. */
type About = {
  name: string; symbol?: string; unit: string; step: number; limits?: [number, number]; logarithmic?: boolean;
  write: (value: number) => string; read?: (text: string) => number;
};
/** Inputs of one number are undone together; `whole`: all of them or none; a refusal is stated `below` a part. */
type Gesture = { gesture?: number; whole?: boolean; below?: Element };
/** What is published, by kind. */
type Messages = {
  scene: Scene; state: State; band: Band | null; redraw: void; drawn: void; steers: void; unchanged: void;
};

/** What the page knows; from `data` to `state` all is there once a needle is shown. */
type Now = {
  data: { needles: Needle[]; kernel: WebAssembly.Module; title?: string; needlefit: string };
  needle: Needle; steered: SteeredNeedle; scene: Scene; state: State; view: View;
  replay: import("./stored.js").Replay | null; band: Band | null; pinned: Curve | null;
  shown: Record<Shown, boolean>; labels: Place[]; avoided: Place[];
};
