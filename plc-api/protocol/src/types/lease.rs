//! The control lease of a coordinate system: the exclusive right to start motion for a limited time.

use serde::{Deserialize, Serialize};

use super::Timestamp;

/// Shortest validity of a lease, ms.
pub const LEASE_TTL_MIN_MS: u64 = 1_000;

/// Longest validity of a lease, ms. Reason: a lost holder must not block a machine for a whole shift.
pub const LEASE_TTL_MAX_MS: u64 = 600_000;

/// Validity of a lease if the request does not contain a validity, ms.
pub const LEASE_TTL_DEFAULT_MS: u64 = 30_000;

/// Largest number of characters of a holder's name.
pub const LEASE_HOLDER_MAX: usize = 64;

/// A request about a lease.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LeaseRequest {
    /// Takes a free lease, or renews the sender's own lease.
    Take(LeaseTake),
    /// Releases the sender's own lease.
    Release(LeaseRelease),
    /// Ends the lease of any holder.
    Break,
}

/// Body of a request to take a lease.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LeaseTake {
    /// Name of the holder as people see it: 1 to 64 characters. Without it, the client id is the name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub holder: Option<String>,
    /// Validity of the lease, ms: 1000 to 600000; 30000 if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ttl_ms: Option<u64>,
    /// Number of the sender's own lease, to renew it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fence: Option<u64>,
}

/// Body of a request to release a lease.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LeaseRelease {
    /// Number of the sender's own lease.
    pub fence: u64,
}

/// A control lease that a client holds.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Lease {
    /// Name of the holder.
    pub holder: String,
    /// Number of the lease; commands under the lease carry this number. It increases with each lease of the
    /// coordinate system, and is never reused.
    pub fence: u64,
    /// Time when the lease ends unless it is renewed.
    pub expires_at: Timestamp,
}

/// Payload of `cs/{cs}/lease/state`: all fields are null while the lease is free.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LeaseState {
    /// Name of the holder.
    pub holder: Option<String>,
    /// Number of the lease.
    pub fence: Option<u64>,
    /// Time when the lease ends unless it is renewed.
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
