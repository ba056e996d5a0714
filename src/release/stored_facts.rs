//! What the list of robots says of a candidate: the first gate that refuses its release, of those that facts in columns decide. The other gates read
//! points, reports and parameters, which takes too long for a list.

use crate::kinematics::Robot;
use crate::release::gate_facts::{Facts, LastCheck};
use crate::release::gates::first_refusal_by_stored_facts;
use crate::release::sessions::Session;
use crate::wire::frames::Transform;
use crate::wire::parameter_set::ParameterSetContent;
use crate::wire::policy::PolicyBody;
use crate::wire::report_summary::ReportSummary;
use crate::wire::verification::Verification;

/// Facts about a candidate that are stored as columns. The fields are as in [`Facts`].
#[derive(Clone, Copy, Debug)]
pub struct StoredFacts<'a> {
    /// The robot's nominal model.
    pub robot: &'a Robot,
    /// Job of the session that does not fit the robot, while the robot is in the state `check_robot`.
    pub check_job_id: Option<&'a str>,
    /// Number of the last session that did not fit the robot; 0 if there is none.
    pub check_seq: i64,
    /// Number of the robot's counter at its last `checked` request; 0 if there is none.
    pub checked_seq: i64,
    /// Verification facts of the job that identified the set.
    pub identification: &'a Verification,
    /// Number of that job in the robot's counter.
    pub identification_seq: i64,
    /// Every session on which the set was scored after its identification, in order.
    pub sessions: &'a [Session],
    /// Whether the set was identified with a joint map that the robot no longer has.
    pub has_other_joint_map: bool,
    /// Code of the suspicion that was overridden for one of its uploads.
    pub insisted_on: Option<&'a str>,
    /// The robot's release policy.
    pub policy: &'a PolicyBody,
}

/// Name of the first gate that refuses the set; `None` if none of these gates does. It is never named if a release would pass it.
pub fn refused_by(stored: &StoredFacts<'_>) -> Option<String> {
    let last_check = (stored.check_seq > 0).then(|| LastCheck {
        seq: stored.check_seq,
        job_id: String::new(),
    });
    // these gates read neither report nor content, except for their texts
    let content = ParameterSetContent {
        links: vec![],
        t_instrument_base: Transform {
            rotation: [[0.0; 3]; 3],
            translation_mm: [0.0; 3],
        },
        targets: vec![],
        links_with_corrections: None,
        corrections: None,
    };
    let facts = Facts {
        robot: stored.robot,
        check_job_id: stored.check_job_id,
        last_check: last_check.as_ref(),
        checked_seq: stored.checked_seq,
        report: &ReportSummary::default(),
        identification: stored.identification,
        identification_seq: stored.identification_seq,
        verify_set_seq: 0,
        content: &content,
        active: None,
        sessions: stored.sessions,
        unscored: None,
        comparisons: &[],
        archived: None,
        has_other_joint_map: stored.has_other_joint_map,
        is_withdrawn: false,
        insisted_source: stored.insisted_on,
        withdrawn_source: None,
        is_rollback: false,
        serial_number: None,
        stated_serial_number: None,
        uploaders: &[],
        approver: "",
        change_reason: None,
        policy: stored.policy,
    };
    first_refusal_by_stored_facts(&facts).map(|gate| gate.gate)
}
