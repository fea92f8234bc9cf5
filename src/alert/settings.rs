//! Where alarms go.

/// One sink.
#[derive(Debug, Clone, PartialEq)]
pub struct SinkSettings {
    /// Its name, unique within the site.
    pub id: String,
}
