/** What the page is given, and what it knows: lengths mm, moduli Pa, forces N, angles degrees unless named otherwise. */

type Change = [name: string, item: number | null, value: number];
type Curve = { x: number[]; y: number[]; z?: number[] | null };
type Errors = { upto_mm: number; whole: boolean; floor_mm: number | null } & { [metric: string]: any };

type Guide = { x: number; y: number; slope: number | null; name: string };
type Bevel = { side: number; roll: number; offset: number; cutAngle: number };
type Controls = {
  baseY: number; baseSlope: number; stageSlope: number; guides: Guide[];
  tip: { y: number; slope: number | null; z?: number } | null;
};
type Step = { depth: number; bevel: Bevel; controls: Controls };

/** A layer by the names of its inputs: `mu_pa`, and the shape parameters of its law. */
type Layer = { [input: string]: number };
type Model = {
  spatial: boolean; length: number; rigidity: number; boundaries: number[]; terms: number;
  mu: number[]; thickness: number[]; friction: number[]; law: number[];
  spacing: number; element: number; firstCell: number; pathAngle: boolean;
  switch: number; tangent: number; tolerance: number; maxIterations: number;
};

/** A needle as the kernel has it: see `mechanics/native/needle.js`. */
type Shape = {
  status: string; passes: number; depth: number; planes: number;
  x: Float64Array; u: Float64Array; slope: Float64Array; constraints: Float64Array; track: Float64Array;
};

type Pose = "known" | "direction" | "free";
type Measured = Curve & {
  id: string; depth_mm: number; s: number[]; floor_mm: number | null;
  compared: "plane" | "space"; metrics: [name: string, label: string, unit: string, text: string][];
  prediction: (Curve & { errors: Errors }) | null;
  target: { x: number[]; y: number[]; z: number[]; s: number[]; pose: Pose };
  stored?: { x: number[]; y: number[]; z: number[] };
};
type Plan = {
  target: [number, number]; radius: number;
  obstacles: [x: number, y: number, radius: number, name: string][]; needles: [number[], number[]][];
};
type Draws = { sets: number; mu: number[]; law: number[]; strength: number[] };

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
  kind: "scene"; title: string; origin_mark: string; length_mm: number; depth_mm: number; diameter_mm: number;
  spacing_mm: number; first_cell_mm: number; layer_names: string[]; guide_names: string[]; boundaries_mm: number[];
  shape_parameters: { name: string; symbol: string; unit: string; explanation: string }[];
  definitions: { [symbol: string]: string };
  fitted: { layers: Layer[]; offset_mm?: number; cut_angle_deg?: number };
  limits: { [input: string]: any; depth_mm: number };
  simulation: { model: Model; shape: number[][]; law: Law; steps: Step[]; changes: Change[][]; rules: Rules };
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
type ShownBevel = { side: number; roll_deg: number; offset_mm?: number; cut_angle_deg?: number };
/** All of a needle that changes from step to step; `z` of a needle in space. */
type State = {
  kind: "state"; step: number; depth_mm: number; x: number[]; y: number[]; z: number[] | null;
  constraints: Curve; tip_path: Curve;
  base: { x: number; y: number; rotation: number; input_y: number; input_slope: number };
  guides: ShownGuide[];
  tip: { x: number; y: number; z: number | null; rotation: number; lateral_mm: number; held: boolean; input_y: number };
  bevel: ShownBevel; layers: Layer[]; max_slope: number; faults: string[]; errors: Errors | null;
};

type Band = { kind: "band"; step: number; x: number[]; low: number[]; high: number[]; z: { low: number[]; high: number[] } | null };

// ---- the picture, px

type Point = [x: number, y: number];
type Scale = (value: number) => number;
type Place = [left: number, top: number, width: number, height: number];
type Box = { left: number; top: number; width: number; height: number };
type View = {
  x: number; y: number; scale: number; magnified: number; fit: "whole" | "tissue" | "tip" | "moved"; of: Scene | null; box: Box;
};
type Font = "small" | "plain" | "strong";
type Looks = { fill?: string; stroke?: string; width?: number; dash?: number[]; opacity?: number };
type TextLooks = { fill: string; font?: Font; align?: "start" | "center" | "end"; halo?: string };
/** What is drawn on: paths as in SVG, texts by their middles, angles counterclockwise, rad. */
type Sheet = {
  path(d: string, looks: Looks): void; text(words: string, place: Point, looks: TextLooks): void;
  within(box: Box, draw: () => void): void; turned(place: Point, angle: number, draw: () => void): void;
};

type Shown = "measured" | "band" | "plan" | "pinned" | "errors" | "points" | "path" | "load" | "inset";

/** What the page knows; from `data` to `state` all is there once a needle is shown. */
type Now = {
  data: { needles: Needle[]; kernel: WebAssembly.Module; title?: string; needlefit: string };
  needle: Needle; steered: import("./model/steered.js").SteeredNeedle; scene: Scene; state: State; view: View;
  replay: import("./stored.js").Replay | null; band: Band | null; pinned: Curve | null;
  shown: Record<Shown, boolean>; labels: Place[]; avoided: Place[];
};
