//! The attitude filter for production: gyro bias in body axes, disturbed references rejected.
//!
//! The binding builds it from `Settings` (serde, defaults for every field, unknown fields refused) by
//! `AttitudeFilter::new(&Settings) -> Result<AttitudeFilter, Error>` under the method name `"filter"`.
