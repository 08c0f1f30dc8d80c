//! The control lease of a coordinate system: the exclusive right to start motion for a while.

use serde::{Deserialize, Serialize};

use super::Timestamp;

/// Shortest time that a lease may be taken for, ms.
pub const LEASE_TTL_MIN_MS: u64 = 1_000;

/// Longest time that a lease may be taken for, ms. Reason: a holder that is gone must not lock a machine for a shift.
pub const LEASE_TTL_MAX_MS: u64 = 600_000;

/// Time that a lease is taken for where none is named, ms.
pub const LEASE_TTL_DEFAULT_MS: u64 = 30_000;

/// Characters of a holder's name.
pub const LEASE_HOLDER_MAX: usize = 64;

/// What is asked of a lease.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LeaseRequest {
    /// Takes a free lease, or renews the own one.
    Take(LeaseTake),
    /// Gives it back.
    Release(LeaseRelease),
    /// Ends it, whoever holds it.
    Break,
}

/// Body of a take.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LeaseTake {
    /// Who holds it, as people are told: 1 to 64 characters. Who leaves it out is named by the client id.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub holder: Option<String>,
    /// For how long, ms: 1000 to 600000, 30000 where it is left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ttl_ms: Option<u64>,
    /// Of the own lease, to renew it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fence: Option<u64>,
}

/// Body of a release.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LeaseRelease {
    /// Of the own lease.
    pub fence: u64,
}

/// A lease that is held.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Lease {
    /// Who holds it.
    pub holder: String,
    /// Its number: what commands carry. Grows with each lease of the coordinate system, and is never used again.
    pub fence: u64,
    /// When it ends unless it is renewed.
    pub expires_at: Timestamp,
}

/// Payload of `cs/{cs}/lease/state`: all fields are null while nobody holds the lease.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LeaseState {
    /// Who holds it.
    pub holder: Option<String>,
    /// Its number.
    pub fence: Option<u64>,
    /// When it ends unless it is renewed.
    pub expires_at: Option<Timestamp>,
}

impl From<Option<Lease>> for LeaseState {
    fn from(lease: Option<Lease>) -> Self {
        lease.map_or_else(Self::default, |lease| Self {
            holder: Some(lease.holder),
            fence: Some(lease.fence),
            expires_at: Some(lease.expires_at),
        })
    }
}
