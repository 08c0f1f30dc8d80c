//! The validity of an X.509 certificate, read from its DER (RFC 5280, 4.1).

use std::time::{Duration, SystemTime};

use sha2::{Digest, Sha256};

/// Time before the end of a certificate or a token in which its end is announced. Reason: a person renews it within a month.
pub(crate) const ANNOUNCED_BEFORE: Duration = Duration::from_hours(30 * 24);

/// Tags of DER.
const SEQUENCE: u8 = 0x30;
const UTC_TIME: u8 = 0x17;
const GENERALIZED_TIME: u8 = 0x18;
const VERSION: u8 = 0xa0;

/// Period in which a certificate is valid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Validity {
    pub(crate) not_before: SystemTime,
    pub(crate) not_after: SystemTime,
}

impl Validity {
    /// Reads the validity of a certificate; returns `None` if the bytes are not a certificate.
    pub(crate) fn of_certificate(der: &[u8]) -> Option<Self> {
        let (certificate, _) = take_tagged_value(der, SEQUENCE)?;
        let (mut fields, _) = take_tagged_value(certificate, SEQUENCE)?;
        // version, if present; serial number, signature algorithm and issuer
        let skipped = if fields.first() == Some(&VERSION) { 4 } else { 3 };
        for _ in 0..skipped {
            fields = take_any(fields)?.2;
        }
        let (validity, _) = take_tagged_value(fields, SEQUENCE)?;
        let (not_before, rest) = time(validity)?;
        let (not_after, _) = time(rest)?;
        Some(Self {
            not_before,
            not_after,
        })
    }
}

/// The certificate that a client has presented.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct ClientCertificate {
    /// SHA-256 of its DER.
    pub(crate) fingerprint: [u8; 32],
    /// Its end; a connection that it has opened ends then, too.
    pub(crate) valid_until: SystemTime,
}

impl ClientCertificate {
    /// Reads a certificate in DER. A certificate without a readable validity has expired.
    pub(crate) fn of_der(der: &[u8]) -> Self {
        let validity = Validity::of_certificate(der);
        Self {
            fingerprint: Sha256::digest(der).into(),
            valid_until: validity.map_or(SystemTime::UNIX_EPOCH, |validity| validity.not_after),
        }
    }
}

/// Returns the days until an end that must be announced; `None` if the end is far away or has passed.
pub(crate) fn days_to_end(end: SystemTime, now: SystemTime) -> Option<u64> {
    let left = end.duration_since(now).ok()?;
    (left <= ANNOUNCED_BEFORE).then_some(left.as_secs() / (24 * 3600))
}

/// Returns the value of this tag, and the rest.
fn take_tagged_value(der: &[u8], tag: u8) -> Option<(&[u8], &[u8])> {
    let (found, value, rest) = take_any(der)?;
    (found == tag).then_some((value, rest))
}

/// Returns the tag of the first value, the value, and the rest.
fn take_any(der: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (&tag, rest) = der.split_first()?;
    let (&first, rest) = rest.split_first()?;
    let (length, rest) = if first < 0x80 {
        (usize::from(first), rest)
    } else {
        // more than four bytes would be longer than any certificate
        let count = usize::from(first & 0x7f);
        if count == 0 || count > 4 || rest.len() < count {
            return None;
        }
        let (bytes, rest) = rest.split_at(count);
        (
            bytes
                .iter()
                .fold(0, |length, byte| length << 8 | usize::from(*byte)),
            rest,
        )
    };
    (rest.len() >= length).then(|| (tag, &rest[..length], &rest[length..]))
}

/// Returns a time, and the rest.
fn time(der: &[u8]) -> Option<(SystemTime, &[u8])> {
    let (tag, value, rest) = take_any(der)?;
    let text = std::str::from_utf8(value).ok()?;
    let text = match tag {
        // years from 50 on are of the last century
        UTC_TIME if text.get(..2)? >= "50" => format!("19{text}"),
        UTC_TIME => format!("20{text}"),
        GENERALIZED_TIME => text.to_owned(),
        _ => return None,
    };
    let part = |from: usize, to: usize| text.get(from..to);
    let written = format!(
        "{}-{}-{}T{}:{}:{}Z",
        part(0, 4)?,
        part(4, 6)?,
        part(6, 8)?,
        part(8, 10)?,
        part(10, 12)?,
        part(12, 14)?
    );
    let time = humantime::parse_rfc3339(&written).ok()?;
    (text.get(14..)? == "Z").then_some((time, rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a certificate that is valid in these years.
    fn certificate(from: i32, until: i32) -> Vec<u8> {
        let key = rcgen::KeyPair::generate().unwrap();
        let mut params = rcgen::CertificateParams::new(["localhost".to_owned()]).unwrap();
        params.not_before = rcgen::date_time_ymd(from, 1, 2);
        params.not_after = rcgen::date_time_ymd(until, 3, 4);
        params.self_signed(&key).unwrap().der().to_vec()
    }

    #[test]
    fn the_validity_of_a_certificate_is_read_in_both_forms_of_time() {
        // from 2050 on RFC 5280 requires the long form
        for (from, until) in [(1999, 2020), (2020, 2049), (2026, 2050), (2060, 2100)] {
            let time = |text: String| humantime::parse_rfc3339(&text).unwrap();
            let expected = Validity {
                not_before: time(format!("{from}-01-02T00:00:00Z")),
                not_after: time(format!("{until}-03-04T00:00:00Z")),
            };
            assert_eq!(
                Validity::of_certificate(&certificate(from, until)),
                Some(expected)
            );
        }
    }

    #[test]
    fn an_end_is_announced_30_days_before_and_not_after() {
        let now = SystemTime::UNIX_EPOCH + Duration::from_hours(24 * 1000);
        let end = |days: u64| now + Duration::from_hours(24 * days);
        assert_eq!(days_to_end(end(31), now), None);
        assert_eq!(days_to_end(end(30), now), Some(30));
        assert_eq!(days_to_end(end(0), now), Some(0));
        assert_eq!(days_to_end(now - Duration::from_secs(1), now), None);
    }

    #[test]
    fn bytes_that_are_no_certificate_have_no_validity() {
        let whole = certificate(2020, 2040);
        for length in 0..whole.len() {
            assert_eq!(Validity::of_certificate(&whole[..length]), None, "{length} bytes");
        }
        for bytes in [
            &b"-----BEGIN"[..],
            &[0x30, 0x80, 0, 0],
            &[0x30, 0x84, 0xff, 0xff, 0xff, 0xff],
        ] {
            assert_eq!(Validity::of_certificate(bytes), None);
        }
    }
}
