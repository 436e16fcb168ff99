//! Time as integer nanoseconds of GPS time, with week numbers and UTC.
//!
//! GPS time starts at 1980-01-06 00:00:00 UTC and has no leap seconds. An `i64` of nanoseconds reaches ±292
//! years and is exact, where an `f64` of GPS seconds resolves only 0.24 µs. Seconds as `f64` appear for
//! differences only.
//!
//! Functions with `builtin` in their name use [`LEAP_SECONDS_BUILTIN`], complete through IERS Bulletin C of
//! the leap second of 2017-01-01 (GPS - UTC = 18 s); a later leap second needs a new table.

/// Nanoseconds in a second.
pub const NS_PER_S: i64 = 1_000_000_000;
/// Nanoseconds in a day.
pub const NS_PER_DAY: i64 = 86_400 * NS_PER_S;
/// Nanoseconds in a GPS week.
pub const NS_PER_WEEK: i64 = 7 * NS_PER_DAY;
/// Weeks after which the week number of the legacy GPS message starts again.
pub const WEEK_ROLLOVER: i64 = 1024;
/// Unix time of the GPS epoch (s).
pub const GPS_EPOCH_UNIX_S: i64 = 315_964_800;

/// First Unix second at which GPS - UTC has a value, and that value (s). Source: IERS, list of leap seconds.
pub const LEAP_SECONDS_BUILTIN: [(i64, i64); 19] = [
    (315_964_800, 0),    // 1980-01-06
    (362_793_600, 1),    // 1981-07-01
    (394_329_600, 2),    // 1982-07-01
    (425_865_600, 3),    // 1983-07-01
    (489_024_000, 4),    // 1985-07-01
    (567_993_600, 5),    // 1988-01-01
    (631_152_000, 6),    // 1990-01-01
    (662_688_000, 7),    // 1991-01-01
    (709_948_800, 8),    // 1992-07-01
    (741_484_800, 9),    // 1993-07-01
    (773_020_800, 10),   // 1994-07-01
    (820_454_400, 11),   // 1996-01-01
    (867_715_200, 12),   // 1997-07-01
    (915_148_800, 13),   // 1999-01-01
    (1_136_073_600, 14), // 2006-01-01
    (1_230_768_000, 15), // 2009-01-01
    (1_341_100_800, 16), // 2012-07-01
    (1_435_708_800, 17), // 2015-07-01
    (1_483_228_800, 18), // 2017-01-01
];

/// An instant: nanoseconds of GPS time since 1980-01-06 00:00:00 UTC.
///
/// Logs with an arbitrary clock use the same type; then only differences have a meaning.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(transparent))]
pub struct Time(i64);

/// Civil UTC. `second` is 60 inside a leap second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Utc {
    /// Gregorian year.
    pub year: i32,
    /// Month, 1 to 12.
    pub month: u8,
    /// Day of the month, 1 to 31.
    pub day: u8,
    /// Hour, 0 to 23.
    pub hour: u8,
    /// Minute, 0 to 59.
    pub minute: u8,
    /// Second, 0 to 59, or 60 in a leap second.
    pub second: u8,
    /// Nanosecond, 0 to 999 999 999.
    pub nanosecond: u32,
}

impl Time {
    /// The GPS epoch.
    pub const EPOCH: Self = Self(0);
    /// Earliest representable instant.
    pub const MIN: Self = Self(i64::MIN);
    /// Latest representable instant.
    pub const MAX: Self = Self(i64::MAX);

    /// Instant from nanoseconds since the epoch.
    #[must_use]
    pub const fn from_ns(t_ns: i64) -> Self {
        Self(t_ns)
    }

    /// Nanoseconds since the epoch.
    #[must_use]
    pub const fn as_ns(self) -> i64 {
        self.0
    }

    /// Instant from the full GPS week and the time of week (ns); `None` outside the range of `i64`.
    ///
    /// A time of week below zero or beyond 604 800 s runs into the neighbouring week.
    #[must_use]
    pub const fn from_week_tow(week: i64, tow_ns: i64) -> Option<Self> {
        match week.checked_mul(NS_PER_WEEK) {
            Some(start) => match start.checked_add(tow_ns) {
                Some(t_ns) => Some(Self(t_ns)),
                None => None,
            },
            None => None,
        }
    }

    /// Full GPS week (negative before the epoch) and time of week (ns) in [0, 604 800e9).
    #[must_use]
    pub const fn week_tow(self) -> (i64, i64) {
        (self.0.div_euclid(NS_PER_WEEK), self.0.rem_euclid(NS_PER_WEEK))
    }

    /// Instant from a week number that restarts every 1024 weeks and a time of week (ns): of all candidates
    /// the nearest to `reference`, which must be known to better than 9.8 years. `None` outside the range of
    /// `i64`.
    #[must_use]
    pub const fn from_truncated_week(week: i64, tow_ns: i64, reference: Self) -> Option<Self> {
        let (reference_week, _) = reference.week_tow();
        let ahead = (week.rem_euclid(WEEK_ROLLOVER) - reference_week).rem_euclid(WEEK_ROLLOVER);
        let later = match Self::from_week_tow(reference_week.saturating_add(ahead), tow_ns) {
            Some(t) => t,
            None => return Self::from_week_tow(reference_week + ahead - WEEK_ROLLOVER, tow_ns),
        };
        match Self::from_week_tow(reference_week + ahead - WEEK_ROLLOVER, tow_ns) {
            Some(earlier) => {
                let behind = (reference.0 as i128 - earlier.0 as i128).abs();
                let before = (later.0 as i128 - reference.0 as i128).abs();
                if behind < before { Some(earlier) } else { Some(later) }
            }
            None => Some(later),
        }
    }

    /// This instant moved by a duration (ns); `None` on overflow.
    #[must_use]
    pub const fn checked_add_ns(self, dt_ns: i64) -> Option<Self> {
        match self.0.checked_add(dt_ns) {
            Some(t_ns) => Some(Self(t_ns)),
            None => None,
        }
    }

    /// `self - earlier` (ns); `None` on overflow.
    #[must_use]
    pub const fn checked_since_ns(self, earlier: Self) -> Option<i64> {
        self.0.checked_sub(earlier.0)
    }

    /// `self - earlier` in seconds. The difference is formed in integers, so only the result is rounded.
    #[must_use]
    pub const fn seconds_since(self, earlier: Self) -> f64 {
        (self.0 as i128 - earlier.0 as i128) as f64 * 1e-9
    }

    /// GPS - UTC (s) at this instant by the built-in table. Inside a leap second it is still the old value.
    #[must_use]
    pub const fn gps_minus_utc_s_builtin(self) -> i64 {
        let mut row = LEAP_SECONDS_BUILTIN.len() - 1;
        while row > 0 {
            let (unix_s, offset_s) = LEAP_SECONDS_BUILTIN[row];
            if self.0 >= (unix_s - GPS_EPOCH_UNIX_S + offset_s) * NS_PER_S {
                return offset_s;
            }
            row -= 1;
        }
        0
    }

    /// Instant of a Unix time (ns since 1970-01-01 UTC, leap seconds not counted) by the built-in table;
    /// `None` on overflow.
    #[must_use]
    pub const fn from_unix_ns_builtin(unix_ns: i64) -> Option<Self> {
        let unix_s = unix_ns.div_euclid(NS_PER_S);
        let mut offset_s = 0;
        let mut row = LEAP_SECONDS_BUILTIN.len();
        while row > 0 {
            row -= 1;
            if unix_s >= LEAP_SECONDS_BUILTIN[row].0 {
                offset_s = LEAP_SECONDS_BUILTIN[row].1;
                break;
            }
        }
        match unix_ns.checked_add((offset_s - GPS_EPOCH_UNIX_S) * NS_PER_S) {
            Some(t_ns) => Some(Self(t_ns)),
            None => None,
        }
    }

    /// Unix time (ns) by the built-in table; `None` on overflow. A leap second maps to the second that
    /// follows it, as Unix time has no other name for it: [`Time::to_utc_builtin`] tells the two apart.
    #[must_use]
    pub const fn to_unix_ns_builtin(self) -> Option<i64> {
        self.0.checked_add((GPS_EPOCH_UNIX_S - self.gps_minus_utc_s_builtin()) * NS_PER_S)
    }

    /// Instant of a civil UTC date and time by the built-in table; `None` for a date or time that does not
    /// exist, including a second 60 where there was no leap second.
    #[must_use]
    pub fn from_utc_builtin(utc: Utc) -> Option<Self> {
        let leap = utc.second == 60;
        let exists = (1..=12).contains(&utc.month)
            && utc.day >= 1
            && utc.day <= days_in_month(utc.year, utc.month)
            && utc.hour < 24
            && utc.minute < 60
            && (utc.second < 60 || leap)
            && i64::from(utc.nanosecond) < NS_PER_S;
        if !exists {
            return None;
        }
        let of_day = (i64::from(utc.hour) * 60 + i64::from(utc.minute)) * 60 + i64::from(utc.second.min(59));
        let unix_s = days_from_civil(utc.year, utc.month, utc.day) * 86_400 + of_day;
        let t = Self::from_unix_ns_builtin(unix_s.checked_mul(NS_PER_S)?)?;
        if !leap {
            return t.checked_add_ns(i64::from(utc.nanosecond));
        }
        let t = t.checked_add_ns(NS_PER_S + i64::from(utc.nanosecond))?;
        t.in_leap_second_builtin().then_some(t)
    }

    /// Civil UTC of this instant by the built-in table; `None` on overflow.
    #[must_use]
    pub fn to_utc_builtin(self) -> Option<Utc> {
        let leap = self.in_leap_second_builtin();
        let shown = if leap { self.checked_add_ns(-NS_PER_S)? } else { self };
        let unix_ns = shown.to_unix_ns_builtin()?;
        let (days, of_day_ns) = (unix_ns.div_euclid(NS_PER_DAY), unix_ns.rem_euclid(NS_PER_DAY));
        let (year, month, day) = civil_from_days(days);
        let of_day = of_day_ns / NS_PER_S;
        Some(Utc {
            year,
            month,
            day,
            hour: (of_day / 3600) as u8,
            minute: (of_day / 60 % 60) as u8,
            second: (of_day % 60) as u8 + u8::from(leap),
            nanosecond: (of_day_ns % NS_PER_S) as u32,
        })
    }

    /// True inside a leap second of the built-in table.
    #[must_use]
    pub fn in_leap_second_builtin(self) -> bool {
        LEAP_SECONDS_BUILTIN.iter().skip(1).any(|&(unix_s, offset_s)| {
            let end_ns = (unix_s - GPS_EPOCH_UNIX_S + offset_s) * NS_PER_S;
            (end_ns - NS_PER_S..end_ns).contains(&self.0)
        })
    }
}

const fn is_leap_year(year: i32) -> bool {
    year % 4 == 0 && (year % 100 != 0 || year % 400 == 0)
}

const fn days_in_month(year: i32, month: u8) -> u8 {
    match month {
        4 | 6 | 9 | 11 => 30,
        2 if is_leap_year(year) => 29,
        2 => 28,
        _ => 31,
    }
}

/// Days from 1970-01-01 of a Gregorian date. The year is counted from March, so the leap day comes last.
const fn days_from_civil(year: i32, month: u8, day: u8) -> i64 {
    let (month, day) = (month as i64, day as i64);
    let year = year as i64 - (month <= 2) as i64;
    let from_march = (month + 9) % 12;
    let of_year = (153 * from_march + 2) / 5 + day - 1;
    365 * year + year.div_euclid(4) - year.div_euclid(100) + year.div_euclid(400) + of_year - 719_468
}

/// Gregorian date of a day counted from 1970-01-01.
const fn civil_from_days(days: i64) -> (i32, u8, u8) {
    let days = days + 719_468;
    let era = days.div_euclid(146_097);
    let of_era = days.rem_euclid(146_097);
    let year_of_era = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let from_march = (5 * of_year + 2) / 153;
    let day = of_year - (153 * from_march + 2) / 5 + 1;
    let month = (from_march + 2) % 12 + 1;
    let year = era * 400 + year_of_era + (month <= 2) as i64;
    (year as i32, month as u8, day as u8)
}
