// Numbers, times and the service's codes as people read them.

const MINUS = "\u2212";
const THIN = "\u202f";

/** About three significant digits; very small and very large ones as powers of ten. */
export function number(value, digits = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size === 0) return "0";
  if (size < 1e-3 || size >= 1e6) return power(value);
  const decimals = Math.max(0, Math.min(6, digits - 1 - Math.floor(Math.log10(size))));
  return value.toFixed(decimals).replace("-", MINUS);
}

function power(value) {
  const [mantissa, exponent] = value.toExponential(1).split("e");
  return `${mantissa}·10${superscript(Number(exponent))}`.replace("-", MINUS);
}

/** 10 to a whole power. */
export function powerOfTen(exponent) {
  return `10${superscript(exponent)}`;
}

function superscript(exponent) {
  return String(exponent).replace(/./g, (c) => (c === "-" ? "⁻" : "⁰¹²³⁴⁵⁶⁷⁸⁹"[Number(c)]));
}

/** No instrument sees less than a tenth of a micrometre: smaller errors are all the same. */
export const SMALLEST_MM = 1e-4;

/** A position error, in mm. */
export function error(value) {
  if (value === null || value === undefined) return "–";
  return value >= 0 && value < SMALLEST_MM ? `<${SMALLEST_MM.toFixed(4)}` : number(value);
}

/** Likewise with its unit. */
export const mm = (value) => (value === null || value === undefined ? "–" : `${error(value)}${THIN}mm`);

/** With a sign and a fixed number of decimals, for columns. */
export function signed(value, decimals = 4) {
  if (value === null || value === undefined) return "–";
  const text = Math.abs(value).toFixed(decimals);
  return (Number(text) === 0 ? "" : value < 0 ? MINUS : "+") + text;
}

/** A local date and time. */
export function when(text) {
  if (!text) return "–";
  return new Date(text).toLocaleString("en-GB", { year: "numeric", month: "short", day: "numeric", hour: "2-digit", minute: "2-digit" });
}

/** How long ago. */
export function age(text) {
  if (!text) return "–";
  const seconds = (Date.now() - new Date(text)) / 1000;
  if (seconds < 60) return "just now";
  return `${span(seconds)} ago`;
}

/** A duration in its largest unit that makes sense. */
export function span(seconds) {
  const units = [["d", 86400], ["h", 3600], ["min", 60]];
  for (const [unit, size] of units) if (seconds >= 1.5 * size) return `${Math.round(seconds / size)}${THIN}${unit}`;
  if (seconds < 1) return `${Math.max(1, Math.round(1000 * seconds))}${THIN}ms`;
  return seconds < 10 ? `${seconds.toFixed(1)}${THIN}s` : `${Math.round(seconds)}${THIN}s`;
}

const METHODS = {
  auto: "automatic", least_squares: "least squares", pso: "particle swarm", bpnn_pso: "network-started swarm", warm_start: "warm start",
  cold_pso: "cold swarm",
};
export const method = (name) => METHODS[name] ?? name.replaceAll("_", " ");

const KINDS = { a: "a", alpha: "α", d: "d", theta_offset: "θ", beta: "β" };
/** `theta_offset_3` as θ₃; what is not a link's is left as it is. */
export function parameter(name) {
  const found = /^(a|alpha|d|theta_offset|beta)_(\d+)$/.exec(name);
  if (!found) return name.replaceAll("_", " ");
  return KINDS[found[1]] + found[2].replace(/\d/g, (c) => "₀₁₂₃₄₅₆₇₈₉"[Number(c)]);
}

export const EVIDENCE = {
  none: ["no evidence", "No point was held out: these errors are those of the fit itself and prove nothing."],
  same_upload: ["same upload", "Checked on points that were not fitted, but measured in the same session: a wrong tool, base or scale would not show."],
  independent_session: ["independent session", "Checked on points of another measuring session: the strongest evidence there is here."],
};

const WARNINGS = {
  tool_uncertain: "The tool is uncertain elsewhere in the workspace",
  robot_changed: "The robot has changed",
  placement_changed: "The robot, the tool or the instrument stands differently",
  outliers_review: "Many points do not fit the others",
  few_verify_points: "Few points to verify on",
  duplicate_poses: "Some poses were measured more than once",
  frame_suspect: "The positions may be in another frame",
  frame_assumed: "The frame was assumed",
  joint_offset_suspect: "A joint's zero looks wrong",
  outside_joint_limits: "Some poses are outside of the joint limits",
  poor_alignment: "Robot and measurements hardly fit together",
  stretch_without_identify_points: "A stretch without points to identify from",
  bad_subset: "The subset column cannot be used",
  unidentifiable_parameters: "Some parameters cannot be told apart",
  no_verify_points: "Nothing was kept to verify",
  no_better_than_nominal: "No better than the nominal robot",
  not_converged: "The search did not settle",
  target_moved: "The reflector moved while measuring",
  base_moved: "The robot's base or the instrument moved while measuring",
  under_determined: "Too few poses to identify from",
  narrow_cloud: "The poses are all close together",
  wide_predictions: "The result is uncertain somewhere in the workspace",
  outliers: "Some points do not fit the others",
};
export const warningTitle = (code) => WARNINGS[code] ?? sentence(code);

const GATES = {
  verified: "Points were held out to verify", verify_errors_improved: "The errors on them became smaller", all_finite: "Every number is finite",
  withdrawn: "It was not withdrawn", sessions_better_than_nominal: "Every session shows it to be better than nominal",
  improved_on_active: "It is at least as good as what is active now", evidence: "How strong the verification is",
  uncertainty_within_tolerance: "Its uncertainty is within the robot's tolerance", verify_errors_within_tolerance: "Its errors are within the robot's tolerance",
  change_plausible: "The parameters changed by a plausible amount", identity: "It is the same robot", second_person: "Who releases is not who uploaded",
};
export const gateTitle = (code) => GATES[code] ?? sentence(code);

const CORRECTIONS = {
  stiffness_2_3: "Stiffness of joints 2 and 3", stiffness_all: "Stiffness of all joints", base_compliance: "Compliance of the base",
  link_masses: "Masses of the links", link_centres: "Centres of gravity", joint_harmonics: "Harmonics of the joints", residual_network: "Residual network",
  all_together: "All of these together",
};
export const correctionTitle = (kind) => CORRECTIONS[kind] ?? sentence(kind);

/** `no_verify_points` as a sentence's beginning. */
export function sentence(code) {
  const words = code.replaceAll("_", " ");
  return words.charAt(0).toUpperCase() + words.slice(1);
}
