// Types of the player's scripts, for readers and for `make check-script`; no page holds them. Interfaces
// of a class name the fields that its constructor assigns together. Points are in diagonals of the
// model from the middle of its rest cage, unless said otherwise; lists of points are flat.

type Point = [number, number, number];
type Points = Float32Array | Float64Array;

// What view/player/section.py packs beside the arrays.
interface Header {
  schema: number;
  arrays: { name: string; type: "f4" | "i1" | "i2" | "u1" | "u2" | "u4"; shape: number[] }[];
  predicted: string[];
  origin: Point;
  diagonal: number;
  levels: number;
  restStep: number;
  lackStep: number;
  vertexCount: number;
  isClip: boolean;
  frames: string[];
  start: number;
  step: number;
  skipped: number[];
  fps: number;
  up: "Y" | "Z";
  parts: { name: string; vertices: number; rms: number | null }[];
  focus: { frame: number; vertex: number; extent: number; turn: number } | null;
  mirror: { normal: Point; point: Point } | null;
  colours: string[];
  signedColours: string[];
  missing: string;
  alpha: number;
  rigidity: number;
  target: string;
  applyUrl: string;
  original: string;
  before: string[];
  ground: number;
  frameRms: (number | null)[];
  held: { frame: number; label: string }[];
  heldStep?: number;
  deviationEnd?: number;
  rms: { top: number; end: number } | null;
}

// Rows of `weights`, `held`, `lack` and `smooth` are of a cage vertex, a frame and axis, an axis, and a motion.
interface Arrays {
  faces: Uint32Array;
  joinedFaces?: Int8Array;
  cageFaces: Uint32Array;
  joinedCageFaces?: Int8Array;
  weights: Int16Array;
  smooth: Float32Array;
  rests: Int8Array;
  lack: Int16Array;
  cage: Float32Array;
  cages: Float32Array;
  rotations: Float32Array;
  vertices?: Uint32Array;
  tints?: Uint8Array;
  rms?: Uint16Array;
  held?: Int16Array;
}

interface Payload { header: Header; arrays: Arrays }

// A point of the surface under a pixel: its face, the corners, and the shares of these.
interface Hit { depth: number; face: number; corners: number[]; barycentric: number[] }

// The colours of a picture, and what its scale says; without `end` there is no scale.
interface Painted { ramp: Float32Array; isTinted?: boolean; low?: number; end?: number; unit?: string; shown?: string[] }

// What pointers and keys on the picture do; see modes.js.
interface Mode {
  name: string;
  grab?(x: number, y: number, event: PointerEvent): boolean;
  drag?(x: number, y: number): void;
  drop?(): void;
  click?(x: number, y: number, event: PointerEvent): void;
  hover?(x: number, y: number, event: PointerEvent): Hover | void;
  press?(event: KeyboardEvent): boolean;
  paint?(values: Float32Array): Painted | null;
  draw?(renderer: Renderer): void;
  chosen?(): number[][];
  show?(): void;
  hide?(): void;
}

// What is under the pointer: what is said of it, the cursor, and the class and points of what highlights it.
interface Hover { text?: string; cursor?: string; kind?: string; points?: number[][] }

interface Modes {
  stage: Stage;
  list: (Mode & { button: any; panel: any; keys: any })[];
  active: any;
  isDragging: boolean;
  transform: Transform | null;
  pointer: [number, number, PointerEvent] | null;
  highlight: HTMLElement;
}

interface Transform {
  stage: Stage;
  kind: string;
  kinds: string;
  axis: string;
  pivot: number[];
  start: number[] | null;
  typed: string;
  angle: number;
  isBegun: boolean;
  isOver: boolean;
  apply(transform: Transform): void;
  end(isKept: boolean): void;
  resize?(factor: number): boolean;
}

// What undo and redo go through.
interface Past { past: any[]; future: any[]; complaint: string; snapshot(): any; restore(state: any): void }

interface Panel { stage: Stage; element: HTMLElement; prefix: string; editor: any }

// What would be lost with a page: texts by the names of its parts, "" where there is nothing. `open` takes such texts,
// and returns the mode that shows them; `send` has them written to a new file.
interface Work {
  parts(): Record<string, string>;
  open(parts: Record<string, string>): string | void;
  send(name: string): Promise<any>;
}

interface Keeper { stage: Stage; session: any; work: Work; saved: Record<string, string>; applied: Record<string, string>; kept: KeptWork; timer: number; isOurs: boolean }

interface KeptWork { store: Storage | null }

interface Clip extends Omit<Header, "held" | "arrays"> { arrays: Arrays; count: number }

interface Renderer { buffers: Record<string, WebGLBuffer>; counts: Record<string, number>; toClip: Float32Array; pixels: number; isSolid: boolean; lift: number[] }

interface Stage {
  section: HTMLElement;
  canvas: HTMLCanvasElement;
  history?: Past;
  travel?: (way: string) => void;
  fold: (isFolded: boolean) => void;
  later?: number | null;
  cages: any;
  modes: Modes;
  timeline: Timeline;
  editor: Editor | null;
  meter?: EditMeter;
  cageEditor?: CageEditor;
  cageService?: CageService;
  work?: Work;
  keeper?: Keeper;
  listeners: ((value?: unknown) => void)[];
  timings: Record<"solve" | "skin" | "normals" | "draw" | "frames", number[]>;
  positions: Float32Array;
  input: Float32Array;
  normals: Float32Array;
  edges?: Uint32Array;
  grid?: any;
  // What other scripts put in place of the usual: of the cage that is drawn, the mesh, its colours, and the parts.
  drawnCage?: () => number[];
  framed?: () => number[];
  mold?: (out: Float32Array) => boolean;
  paint?: (values: Float32Array) => Painted | null;
  selectShown?: (corners: Uint32Array, size: number) => Uint32Array;
}

// The mesh before, and ghosts; `drawn` are those of neighbouring frames.
interface Before {
  stage: Stage;
  choice: HTMLSelectElement;
  isHeld: boolean;
  kept: Map<string, Float32Array>;
  asking: string;
  errors: Record<string, string>;
  drawn: { name: string; paint: number[] }[];
  ghosts: number;
  every: number;
}

interface Skin { shown?: Uint32Array }

interface Camera { upright: Point[]; target: Point; shift: Point; turn: number; tilt: number; distance: number; width: number; height: number }

interface Transport { count: number; fps: number; speed: number; loop: boolean; smooth: boolean }

interface Timeline { strip: HTMLElement; ends: [number, number]; marks: Record<string, any> }

interface Editor {
  file: any;
  cageFile: any;
  stage: Stage;
  clip: Clip;
  skin: Skin;
  rounds: number;
  surfaceHeld?: HeldSurface;
  isDragging: boolean;
  before: string | null;
}

// Edits of the cage by hand, and what of it is chosen.
interface CageEditing { stage: Stage; clip: Clip; editor: Editor; active: number; mirrors: boolean; selection: CageSelection; pivots: string; cursor: number[] }

interface CageSelection { findCage: () => Points; falloff: string; radius: number }

interface Poser { rows: Float64Array[]; rings: any; normal: any; solvers: any; surface: HeldSurface | null; mirror: { normal: Point; point: Point } | null; size: number }

interface CoordinateSolver { rings: number[][]; count: number; column: Int32Array; share: Float64Array; gram?: Float64Array[] }

interface HeldSurface { skin: Skin; faces: Uint32Array; areas: Float64Array }

interface Heap { keys: number[]; values: number[] }

interface EditMeter { stage: Stage; found: Map<number, any>; waiting: number[]; before: Float32Array; after: Float32Array; cages?: Map<number, any> }

interface Influence { stage: Stage; skin: Skin; vertex: number; place: { near: number; corners: number[]; shares: number[] } | null; row: Float64Array | null }

interface Window { cageikPlayer: Promise<unknown> }

// A cage that is edited at rest: its vertices, and its polygons as rings of vertices.
interface CageMesh { vertices: Point[]; polygons: number[][]; foundSides?: any; foundEdges?: any; foundFaults?: any }

type ElementKind = "vertices" | "edges" | "faces";

interface CageEditor { mesh: CageMesh; most: number; kind: ElementKind; chosen: Set<number> }

interface CageService { tell: () => void; queue: Promise<unknown>; waiting: any; verdict: any; solved: any; error: string }

interface SelectionBox { camera: Camera; from: number[]; to: number[] }
