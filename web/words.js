// The service's codes in plain words, one on each line. The program reads this file, too, for its report page and the terminal; a test
// looks for every code that the service can give.

export const WARNINGS = {
  at_bound: "A parameter ended at the edge of what was allowed",
  bad_subset: "The subset column cannot be used",
  base_moved: "The robot's base or the instrument moved while measuring",
  base_not_checked: "A wrong base would not show in these points",
  column_suspect: "Columns or rows seem to be exchanged",
  corrections_left_out: "What links cannot say was not looked for",
  corrections_worse_on_verify_points: "The corrections were dropped: the points to verify fit better without them",
  duplicate_poses: "Some poses were measured more than once",
  few_verify_points: "Few points to verify on",
  frame_assumed: "The frame was assumed",
  frame_suspect: "The positions may be in another frame",
  held_uncertainty_unknown: "How sure the parameters are that were held is not known",
  insisted_upload: "These points were refused, and kept because the uploader insisted",
  implausible_parameters: "The parameters changed more than a robot plausibly does",
  joint_hardly_moves: "A joint hardly moves",
  joint_map_suspect: "The controller seems to count its joints otherwise",
  joint_offset_suspect: "A joint's zero looks wrong",
  model_too_small: "The model is too small for these points",
  no_better_than_nominal: "No better than the nominal robot",
  no_verify_points: "Nothing was kept to verify",
  not_converged: "The search did not settle",
  orientation_not_known: "It is not known how the flange is turned: only the position of the measured reflector can be relied on",
  outliers: "Some points do not fit the others",
  outliers_review: "Many points do not fit the others",
  outside_joint_limits: "Some poses are outside of the joint limits",
  placement_changed: "The robot, the tool or the instrument stands differently",
  poor_alignment: "Robot and measurements hardly fit together",
  poses_not_spread: "The poses are all close together",
  prior_contradicted: "The points contradict what was known beforehand",
  robot_changed: "The robot has changed",
  robot_mismatch: "It seems to have been measured on another robot",
  session_does_not_fit: "This file does not fit this robot",
  session_shows_little: "These poses show too little of the robot to be evidence",
  set_far_off: "The parameter set misses this session by far",
  scale_suspect: "All lengths are off by the same share",
  subsets_differ: "Points to verify do not belong to the others",
  stretch_without_identify_points: "A stretch without points to identify from",
  target_moved: "The reflector moved while measuring",
  nothing_left_to_judge: "As many equations as unknowns: nothing says how good the fit is",
  no_fit: "The identified robot does not fit the points: joints and positions do not belong together, or it is another robot",
  pose_not_seen: "The measured positions do not show all of where the flange is: only the measured reflector is sure",
  tool_uncertain: "The tool is uncertain elsewhere in the workspace",
  under_determined: "Too few poses to identify from",
  unit_suspect: "Joints or positions seem to be in other units",
  unidentifiable_parameters: "Some parameters cannot be told apart",
  verify_extrapolates: "Points to verify lie beyond what the identify points fix; their errors are those of an extrapolation",
};

// Warnings of reports with which nothing is to be done but what stands here; the first that a report has counts.
export const NO_USE = {
  model_too_small: "The model is too small for these points, and nothing that was found is of use: ask for model complete",
  no_fit: "The points do not fit the robot, and nothing that was found is of use: check the file",
  joint_map_suspect: "The points fit only with a joint counted in another way, and nothing that was found is of use: correct the robot's joint map",
  session_does_not_fit: "This file does not fit this robot, and is no evidence for anything: check the file, then look at the robot",
  set_far_off: "These points fit the robot, and the parameter set misses them by far: identify anew",
  no_better_than_nominal: "On the points to verify it is no better than the nominal robot: do not use it",
};

// Codes of refusals on which an uploader may insist.
export const SUSPICIONS = ["unit_suspect", "column_suspect", "frame_suspect", "joint_map_suspect", "robot_mismatch", "poor_alignment"];

export const GATES = {
  all_finite: "Every number is finite",
  fits: "The identified robot fits the points",
  change_plausible: "The parameters changed by a plausible amount",
  orientation_known: "It is known how the flange is turned",
  check_robot: "Every session fits the robot, or somebody said why not",
  evidence: "How strong the verification is",
  identity: "It is the same robot",
  measured_since_check: "It holds since a session did not fit the robot",
  improved_on_active: "It is at least as good as what is active now",
  second_person: "Who releases is not who uploaded",
  sessions_fit: "The set fits the sessions that it was scored on",
  sessions_better_than_nominal: "Every session shows it to be better than nominal",
  upload_not_insisted: "No upload that it rests on was insisted on",
  uncertainty_within_tolerance: "Its uncertainty is within the robot's tolerance",
  verified: "Points were held out to verify",
  verify_errors_improved: "The errors on them became smaller",
  final_fit_near_verified: "The delivered parameters are near the verified ones",
  verify_errors_within_tolerance: "Its errors are within the robot's tolerance",
  withdrawn: "It was not withdrawn",
};

export const CORRECTIONS = {
  all_together: "All of these together",
  base_compliance: "Compliance of the base",
  joint_harmonics: "Harmonics of the joints",
  link_centres: "Centres of gravity",
  link_masses: "Masses of the links",
  residual_network: "Residual network",
  stiffness_2_3: "Stiffness of joints 2 and 3",
  stiffness_all: "Stiffness of all joints",
};

export const METHODS = {
  auto: "automatic",
  bpnn_pso: "network-started swarm",
  cold_pso: "cold swarm",
  least_squares: "least squares",
  pso: "particle swarm",
  warm_start: "warm start",
};

export const STAGES = {
  screening: "Screening the points",
  least_squares: "Least squares",
  pso: "Particle swarm",
  bpnn_pso: "Network-started swarm",
  train_network: "Training a network on the swarm",
  refine: "Refining by least squares",
  corrections: "Looking for what links cannot say",
  compare_least_squares: "Least squares on the same points, to compare",
  compare_pso: "Cold swarm on the same points, to compare",
  compare_warm_start: "Warm start on the same points, to compare",
  final_fit: "Fitting all points",
  uncertainty: "Working out errors and uncertainties",
  held_uncertainty: "Working out how sure the held parameters are",
  compare_sessions: "Comparing with the session before",
  verify: "Scoring the points",
};
