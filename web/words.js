// The service's codes in plain words, one on each line. The program reads this file, too, for its report page and the terminal; a test
// looks for every code that the service can give.

export const WARNINGS = {
  at_bound: "A parameter ended at the edge of what was allowed",
  bad_subset: "The subset column cannot be used",
  base_moved: "The robot's base or the instrument moved while measuring",
  corrections_left_out: "What links cannot say was not looked for",
  duplicate_poses: "Some poses were measured more than once",
  few_verify_points: "Few points to verify on",
  frame_assumed: "The frame was assumed",
  frame_suspect: "The positions may be in another frame",
  held_uncertainty_unknown: "How sure the parameters are that were held is not known",
  implausible_parameters: "The parameters changed more than a robot plausibly does",
  joint_hardly_moves: "A joint hardly moves",
  joint_offset_suspect: "A joint's zero looks wrong",
  model_too_small: "The model is too small for these points",
  no_better_than_nominal: "No better than the nominal robot",
  no_verify_points: "Nothing was kept to verify",
  not_converged: "The search did not settle",
  outliers: "Some points do not fit the others",
  outliers_review: "Many points do not fit the others",
  outside_joint_limits: "Some poses are outside of the joint limits",
  placement_changed: "The robot, the tool or the instrument stands differently",
  poor_alignment: "Robot and measurements hardly fit together",
  poses_not_spread: "The poses are all close together",
  prior_contradicted: "The points contradict what was known beforehand",
  robot_changed: "The robot has changed",
  scale_suspect: "All lengths are off by the same share",
  stretch_without_identify_points: "A stretch without points to identify from",
  target_moved: "The reflector moved while measuring",
  no_fit: "The identified robot does not fit the points: joints and positions do not belong together, or it is another robot",
  pose_not_seen: "The measured positions do not show all of where the flange is: only the measured reflector is sure",
  tool_uncertain: "The tool is uncertain elsewhere in the workspace",
  under_determined: "Too few poses to identify from",
  unidentifiable_parameters: "Some parameters cannot be told apart",
  verify_extrapolates: "Points to verify lie beyond what the identify points fix; their errors are those of an extrapolation",
};

export const GATES = {
  all_finite: "Every number is finite",
  fits: "The identified robot fits the points",
  change_plausible: "The parameters changed by a plausible amount",
  evidence: "How strong the verification is",
  identity: "It is the same robot",
  improved_on_active: "It is at least as good as what is active now",
  second_person: "Who releases is not who uploaded",
  sessions_better_than_nominal: "Every session shows it to be better than nominal",
  uncertainty_within_tolerance: "Its uncertainty is within the robot's tolerance",
  verified: "Points were held out to verify",
  verify_errors_improved: "The errors on them became smaller",
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
