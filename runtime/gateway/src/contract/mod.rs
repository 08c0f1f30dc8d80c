//! The interface as tables: every route and every incoming topic, from the rows of the wire. Routing, access and the
//! generated documents read the same tables: a route without a row is not served, and a topic without a row is not
//! subscribed.

pub(crate) mod routes;
pub(crate) mod topics;

#[cfg(test)]
mod asyncapi;
#[cfg(test)]
mod openapi;
#[cfg(test)]
mod outbound;
#[cfg(test)]
mod python;
#[cfg(test)]
mod schemas;
#[cfg(test)]
pub(crate) mod tests;
#[cfg(test)]
mod typescript;
