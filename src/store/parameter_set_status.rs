//! The life of a parameter set.

/// Status of a parameter set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParameterSetStatus {
    /// Just identified.
    Candidate,
    /// The robot's active one.
    Released,
    /// It was active until another one was released.
    Superseded,
    /// Not to be used.
    Withdrawn,
}

impl ParameterSetStatus {
    /// As in api.md.
    pub fn as_str(self) -> &'static str {
        match self {
            ParameterSetStatus::Candidate => "candidate",
            ParameterSetStatus::Released => "released",
            ParameterSetStatus::Superseded => "superseded",
            ParameterSetStatus::Withdrawn => "withdrawn",
        }
    }
}

impl TryFrom<String> for ParameterSetStatus {
    type Error = String;

    fn try_from(text: String) -> std::result::Result<Self, String> {
        [
            ParameterSetStatus::Candidate,
            ParameterSetStatus::Released,
            ParameterSetStatus::Superseded,
            ParameterSetStatus::Withdrawn,
        ]
        .into_iter()
        .find(|status| status.as_str() == text)
        .ok_or_else(|| format!("unknown parameter set status {text:?}"))
    }
}
