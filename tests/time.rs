//! Weeks, leap seconds, civil dates and overflow.

use gnssins::time::{NS_PER_S, NS_PER_WEEK, Time, Utc};
use proptest::prelude::*;

#[test]
fn weeks_and_time_of_week_equal_known_dates() {
    let utc = |year, month, day, hour, minute, second| Utc {
        year,
        month,
        day,
        hour,
        minute,
        second,
        nanosecond: 0,
    };
    let week_s = |u: Utc| {
        let (week, tow_ns) = Time::from_utc_builtin(u).unwrap().week_tow();
        (week, tow_ns / NS_PER_S)
    };
    assert_eq!(week_s(utc(1980, 1, 6, 0, 0, 0)), (0, 0));
    assert_eq!(week_s(utc(1999, 8, 21, 23, 59, 47)), (1024, 0));
    assert_eq!(week_s(utc(2017, 1, 1, 0, 0, 0)), (1930, 18));
    assert_eq!(week_s(utc(2019, 4, 6, 23, 59, 42)), (2048, 0));
    assert_eq!(week_s(utc(2023, 11, 14, 22, 13, 20)), (2288, 252_818));
}

#[test]
fn a_negative_instant_lies_in_the_week_before_the_epoch() {
    assert_eq!(Time::from_ns(-1).week_tow(), (-1, NS_PER_WEEK - 1));
    assert_eq!(Time::from_week_tow(-1, NS_PER_WEEK - 1), Some(Time::from_ns(-1)));
}

#[test]
fn leap_second_is_counted_once_and_named_sixty() {
    let last =
        Utc { year: 2016, month: 12, day: 31, hour: 23, minute: 59, second: 59, nanosecond: 999_999_999 };
    let leap = Utc { second: 60, nanosecond: 500_000_000, ..last };
    let next = Utc { year: 2017, month: 1, day: 1, hour: 0, minute: 0, second: 0, nanosecond: 0 };
    let [last_t, leap_t, next_t] = [last, leap, next].map(|u| Time::from_utc_builtin(u).unwrap());
    assert_eq!(leap_t.checked_since_ns(last_t), Some(500_000_001));
    assert_eq!(next_t.checked_since_ns(leap_t), Some(500_000_000));
    assert_eq!([last_t, leap_t, next_t].map(|t| t.to_utc_builtin().unwrap()), [last, leap, next]);
    assert_eq!([last_t, leap_t, next_t].map(Time::gps_minus_utc_s_builtin), [17, 17, 18]);
    assert_eq!(Time::from_utc_builtin(Utc { year: 2018, ..leap }), None);
}

#[test]
fn leap_table_holds_the_eighteen_announced_dates() {
    // IERS Bulletin C: a second was inserted before these first days of a month.
    let announced = [
        (1981, 7),
        (1982, 7),
        (1983, 7),
        (1985, 7),
        (1988, 1),
        (1990, 1),
        (1991, 1),
        (1992, 7),
        (1993, 7),
        (1994, 7),
        (1996, 1),
        (1997, 7),
        (1999, 1),
        (2006, 1),
        (2009, 1),
        (2012, 7),
        (2015, 7),
        (2017, 1),
    ];
    for (row, (year, month)) in announced.into_iter().enumerate() {
        let day = Utc { year, month, day: 1, hour: 0, minute: 0, second: 0, nanosecond: 0 };
        let start = Time::from_utc_builtin(day).unwrap();
        let before = start.checked_add_ns(-1).unwrap();
        assert_eq!(start.gps_minus_utc_s_builtin(), row as i64 + 1, "{year}-{month}");
        assert_eq!(before.gps_minus_utc_s_builtin(), row as i64, "{year}-{month}");
        assert_eq!(before.to_utc_builtin().unwrap().second, 60, "{year}-{month}");
    }
}

#[test]
fn impossible_dates_are_refused() {
    let good = Utc { year: 2024, month: 2, day: 29, hour: 12, minute: 0, second: 0, nanosecond: 0 };
    assert!(Time::from_utc_builtin(good).is_some());
    for bad in [
        Utc { year: 2023, ..good },
        Utc { year: 2100, ..good },
        Utc { month: 13, ..good },
        Utc { month: 0, ..good },
        Utc { day: 0, ..good },
        Utc { hour: 24, ..good },
        Utc { minute: 60, ..good },
        Utc { second: 61, ..good },
        Utc { nanosecond: 1_000_000_000, ..good },
        Utc { year: 2400, ..good },
        Utc { year: i32::MIN, ..good },
    ] {
        assert_eq!(Time::from_utc_builtin(bad), None, "{bad:?}");
    }
}

#[test]
fn truncated_week_takes_the_candidate_nearest_to_the_reference() {
    let reference = Time::from_week_tow(2288, 0).unwrap();
    for week in [1780i64, 1930, 2288, 2799] {
        let t = Time::from_week_tow(week, 5 * NS_PER_S);
        assert_eq!(Time::from_truncated_week(week % 1024, 5 * NS_PER_S, reference), t);
        assert_eq!(Time::from_truncated_week(week, 5 * NS_PER_S, reference), t);
    }
    // Just before and after a rollover the reference of the other side gives the same week.
    let eve = Time::from_week_tow(2047, NS_PER_WEEK - 1).unwrap();
    assert_eq!(Time::from_truncated_week(0, 0, eve), Time::from_week_tow(2048, 0));
    assert_eq!(
        Time::from_truncated_week(1023, 0, Time::from_week_tow(2048, 1).unwrap()),
        Time::from_week_tow(2047, 0)
    );
    for extreme in [Time::MIN, Time::MAX] {
        let _ = Time::from_truncated_week(i64::MIN, i64::MAX, extreme);
        let _ = Time::from_truncated_week(i64::MAX, i64::MIN, extreme);
    }
}

#[test]
fn overflow_is_none_and_never_a_panic() {
    assert_eq!(Time::MAX.checked_add_ns(1), None);
    assert_eq!(Time::MIN.checked_since_ns(Time::MAX), None);
    assert_eq!(Time::from_week_tow(i64::MAX, 0), None);
    assert_eq!(Time::from_unix_ns_builtin(i64::MIN), None);
    assert_eq!(Time::MAX.to_unix_ns_builtin(), None);
    assert_eq!(Time::MAX.to_utc_builtin(), None);
    let _ = (Time::MIN.to_utc_builtin(), Time::MIN.week_tow(), Time::MAX.gps_minus_utc_s_builtin());
    assert_eq!(Time::MAX.seconds_since(Time::MIN), 1.844_674_407_370_955_2e10);
}

#[test]
fn differences_in_seconds_do_not_lose_nanoseconds() {
    let t = Time::from_week_tow(2288, 0).unwrap();
    assert_eq!(t.checked_add_ns(5_000_001).unwrap().seconds_since(t), 5_000_001.0 * 1e-9);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..Default::default() })]

    #[test]
    fn unix_time_survives_gps_time(
        unix_s in 315_964_800i64..4_000_000_000,
        nanosecond in 0i64..1_000_000_000,
    ) {
        let unix_ns = unix_s * NS_PER_S + nanosecond;
        let t = Time::from_unix_ns_builtin(unix_ns).unwrap();
        prop_assert_eq!(t.to_unix_ns_builtin(), Some(unix_ns));
        prop_assert_eq!(Time::from_utc_builtin(t.to_utc_builtin().unwrap()), Some(t));
    }

    #[test]
    fn week_and_time_of_week_survive(t_ns in any::<i64>()) {
        let (week, tow_ns) = Time::from_ns(t_ns).week_tow();
        prop_assert!((0..NS_PER_WEEK).contains(&tow_ns));
        // Only the first, incomplete week of the range starts before the earliest instant.
        let start_fits = week.checked_mul(NS_PER_WEEK).is_some();
        prop_assert_eq!(Time::from_week_tow(week, tow_ns), start_fits.then_some(Time::from_ns(t_ns)));
    }
}
