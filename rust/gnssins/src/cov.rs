//! Covariance: block-structured prediction, scalar Joseph update, health.

use crate::discretise::{BlockStep, LAST, Transition};
use crate::error::Error;
use crate::math;
use crate::nav::NAV;
use crate::simd::{self, Aligned, Eight, Isa, Kernel, LANES, Lanes, Plain, madd, one_by_one};

/// Calls a kernel for all nine rows, as many at a time as registers hold.
macro_rules! by_groups {
    ($e:ident, $cap:ident, $kernel:ident, ($($arg:expr),*)) => {
        match $e::SUMS {
            9.. => $kernel::<$e, $cap, 0, 9>($($arg),*),
            5.. => {
                $kernel::<$e, $cap, 0, 5>($($arg),*);
                $kernel::<$e, $cap, 5, 4>($($arg),*);
            }
            _ => {
                $kernel::<$e, $cap, 0, 2>($($arg),*);
                $kernel::<$e, $cap, 2, 2>($($arg),*);
                $kernel::<$e, $cap, 4, 2>($($arg),*);
                $kernel::<$e, $cap, 6, 2>($($arg),*);
                $kernel::<$e, $cap, 8, 1>($($arg),*);
            }
        }
    };
}

/// Symmetric covariance of up to `CAP` states; rows beyond the `n` in use are zero. `CAP` is a multiple of 8.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(align(64))]
pub struct Covariance<const CAP: usize> {
    p: [[f64; CAP]; CAP],
    n: usize,
}

impl<const CAP: usize> Covariance<CAP> {
    const CHECKED: () =
        assert!(CAP.is_multiple_of(LANES) && CAP > NAV, "CAP must be a multiple of 8, at least 16");

    /// Diagonal covariance from the variances of the first `n` states.
    #[must_use]
    pub fn from_variances(variances: &[f64; CAP], n: usize) -> Self {
        const { Self::CHECKED }
        let n = n.min(CAP);
        let mut p = [[0.0; CAP]; CAP];
        for i in 0..n {
            p[i][i] = variances[i];
        }
        Self { p, n }
    }

    /// Number of states in use.
    #[must_use]
    pub const fn len(&self) -> usize {
        // never more than there are: the compiler cannot know that of a field
        if self.n < CAP { self.n } else { CAP }
    }

    /// Never: a filter has states.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.n == 0
    }

    /// The padded rows.
    #[must_use]
    pub const fn rows(&self) -> &[[f64; CAP]; CAP] {
        &self.p
    }

    /// Element (i, j), 0 outside the matrix.
    #[must_use]
    pub fn get(&self, i: usize, j: usize) -> f64 {
        self.p.get(i).and_then(|row| row.get(j)).copied().unwrap_or(0.0)
    }

    /// Sets (i, j) and (j, i).
    pub(crate) fn set(&mut self, i: usize, j: usize, value: f64) {
        for (i, j) in [(i, j), (j, i)] {
            if let Some(a) = self.p.get_mut(i).and_then(|row| row.get_mut(j)) {
                *a = value;
            }
        }
    }

    /// `P <- Phi (P + Q/2) Phi' + Q/2` with Phi = [A B; 0 D], D diagonal: the product is never formed n x n. Runs on the
    /// widest instructions of the machine.
    pub fn predict(&mut self, t: &Transition<CAP>) {
        self.predict_on(Isa::detect(), t);
    }

    /// As [`Covariance::predict`], on a given set of instructions where the machine has it.
    pub fn predict_on(&mut self, isa: Isa, t: &Transition<CAP>) {
        simd::run(isa, Predict { cov: self, t });
    }

    /// The rest of [`Covariance::predict`] after [`Covariance::add_half_noise`].
    #[inline(always)]
    pub(crate) fn predict_kernel<E: Eight>(&mut self, t: &Transition<CAP>) {
        let n = self.n;
        let half = t.half_noise();
        for (row, half) in self.p.iter_mut().zip(&half.0) {
            add_to_first::<E, CAP>(row, half);
        }
        // W = [A B] (P + Q/2), nine rows in the place of those of P: eight columns of W need only these of P
        let mut w = Aligned([[0.0; LANES]; NAV]);
        for tile in 0..n.div_ceil(LANES).min(CAP / LANES) {
            by_groups!(E, CAP, top_rows_times, (t, &self.p, n, tile, &mut w.0));
            for (row, w) in self.p.iter_mut().zip(&w.0) {
                E::load(w).store(&mut lanes_mut(row)[tile]);
            }
        }
        let (top, rest) = self.p.split_at_mut(NAV);
        let (tiles, diagonal) = (lanes(&t.blocks.diagonal), &t.blocks.diagonal);
        let corner = dot::<E, CAP>(&top[LAST], &t.last.0);
        let mut last = [0.0; CAP];
        for ((w, d), last) in top[LAST].iter().zip(diagonal).zip(&mut last) {
            *last = w * d;
        }
        // the mirror of the cross block W D, and block by block: D P D
        for tile in 1..n.div_ceil(LANES).min(CAP / LANES) {
            let mut rows = [E::splat(0.0); LANES];
            for (row, w) in rows.iter_mut().zip(&*top) {
                *row = E::load(&lanes(w)[tile]);
            }
            let columns = E::transpose(rows);
            for k in (tile * LANES).max(NAV)..((tile + 1) * LANES).min(n) {
                let (row, d) = (&mut rest[k - NAV], E::splat(diagonal[k]));
                for (p, tile) in lanes_mut(row).iter_mut().zip(tiles).skip(1) {
                    E::load(p).times(E::load(tile).times(d)).store(p);
                }
                if let Some(p) = lanes_mut(row).first_mut() {
                    columns[k % LANES].times(d).store(p);
                }
                row[LAST] = last[k];
            }
        }
        // navigation block: W [A B]', the lower triangle for both; row by row in the place of W
        by_groups!(E, CAP, rows_times_top, (top, t, n));
        for i in 0..LANES {
            for j in 0..i {
                top[j][i] = top[i][j];
            }
        }
        let below = top[LAST];
        for (i, (row, half)) in top.iter_mut().zip(&half.0).enumerate() {
            // cross block: W D
            for (p, d) in lanes_mut(row).iter_mut().zip(tiles).skip(1) {
                E::load(p).times(E::load(d)).store(p);
            }
            add_to_first::<E, CAP>(row, half);
            row[LAST] = if i == LAST { corner } else { below[i] };
        }
        self.add_half_noise(&t.blocks);
    }

    /// Half of the noise of the block states. Number by number: a vector that holds one of them must not be read right
    /// after, so the half before a prediction is added long before it.
    #[inline(always)]
    pub(crate) fn add_half_noise(&mut self, blocks: &BlockStep<CAP>) {
        for k in NAV..self.n.min(CAP) {
            one_by_one();
            self.p[k][k] += 0.5 * blocks.q[k];
        }
    }

    /// Gain of a scalar measurement `y = h x - noise` with unit noise variance, and the covariance after it, by the
    /// Joseph form in two rank-one steps: A = P - k (hP); P⁺ = A - (A h') k' + k k', then mirrored.
    ///
    /// Returns the gain k = P h'/(h P h' + 1), or `None` (nothing changed) when h P h' + 1 is not positive.
    pub fn update(&mut self, h: &[f64; CAP]) -> Option<[f64; CAP]> {
        let gain = self.update_kernel::<Plain>(&Sparse::of(h))?;
        self.mirror::<Plain>();
        Some(gain.0)
    }

    /// As [`Covariance::update`], without the mirroring: what is left of asymmetry after some rows is rounding.
    ///
    /// A h' needs few rows of A, so that both steps are one pass over P.
    #[inline(always)]
    pub(crate) fn update_kernel<E: Eight>(&mut self, h: &Sparse<CAP>) -> Option<Aligned<[f64; CAP]>> {
        let n = self.n;
        let ph = self.times_kernel::<E>(h);
        let s = h.dot::<E>(&ph.0) + 1.0;
        if !(s.is_finite() && s > 0.0) {
            return None;
        }
        let inverse = E::splat(1.0 / s);
        let mut k = Aligned([0.0; CAP]);
        for (k, ph) in lanes_mut(&mut k.0).iter_mut().zip(lanes(&ph.0)) {
            inverse.times(E::load(ph)).store(k);
        }
        let mut c = k;
        for (j, hj) in h.iter() {
            let (minus, hj) = (E::splat(-k.0[j]), E::splat(-hj));
            for ((c, p), ph) in lanes_mut(&mut c.0).iter_mut().zip(lanes(&self.p[j])).zip(lanes(&ph.0)) {
                let a = E::load(p).madd(minus, E::load(ph));
                E::load(c).madd(hj, a).store(c);
            }
        }
        let n = n.min(CAP);
        for ((row, &ki), &ci) in self.p[..n].iter_mut().zip(&k.0[..n]).zip(&c.0[..n]) {
            let (minus, ci) = (E::splat(-ki), E::splat(ci));
            for ((p, ph), k) in lanes_mut(row).iter_mut().zip(lanes(&ph.0)).zip(lanes(&k.0)) {
                E::load(p).madd(minus, E::load(ph)).madd(ci, E::load(k)).store(p);
            }
        }
        Some(k)
    }

    /// P h' for a row h.
    #[must_use]
    pub fn times(&self, h: &[f64; CAP]) -> [f64; CAP] {
        self.times_kernel::<Plain>(&Sparse::of(h)).0
    }

    /// As [`Covariance::times`], for a kernel.
    #[inline(always)]
    pub(crate) fn times_kernel<E: Eight>(&self, h: &Sparse<CAP>) -> Aligned<[f64; CAP]> {
        let mut out = Aligned([0.0; CAP]);
        for (j, hj) in h.iter() {
            let hj = E::splat(hj);
            for (o, p) in lanes_mut(&mut out.0).iter_mut().zip(lanes(&self.p[j])) {
                E::load(o).madd(hj, E::load(p)).store(o);
            }
        }
        out
    }

    /// Adds to the variance of a state.
    pub(crate) fn add_variance(&mut self, i: usize, variance: f64) {
        self.p[i][i] += variance;
    }

    /// Raises variances below their lower bound to it: what is added to the diagonal keeps P positive definite.
    pub(crate) fn raise_to(&mut self, floor: &[f64; CAP]) {
        for (i, &v) in floor.iter().enumerate().take(self.n) {
            self.p[i][i] = self.p[i][i].max(v);
        }
    }

    /// Multiplies a state's sigma, its correlations unchanged.
    pub(crate) fn scale_state(&mut self, i: usize, factor: f64) {
        self.p.get_mut(i).into_iter().flatten().for_each(|a| *a *= factor);
        self.p.iter_mut().filter_map(|row| row.get_mut(i)).for_each(|a| *a *= factor);
    }

    /// `P <- G P G'` where G differs from I only in the 3x3 block at `START`: three rows, and the columns after them.
    #[inline(always)]
    pub(crate) fn transform3<E: Eight, const START: usize>(&mut self, g: &nalgebra::Matrix3<f64>) {
        let rows = &mut self.p[START..START + 3];
        for tile in 0..CAP / LANES {
            let mut old = [E::splat(0.0); 3];
            for (old, row) in old.iter_mut().zip(&*rows) {
                *old = E::load(&lanes(row)[tile]);
            }
            for (i, row) in rows.iter_mut().enumerate() {
                let sum = old[0].times(E::splat(g[(i, 0)])).madd(old[1], E::splat(g[(i, 1)]));
                sum.madd(old[2], E::splat(g[(i, 2)])).store(&mut lanes_mut(row)[tile]);
            }
        }
        let old =
            core::array::from_fn::<_, 3, _>(|i| core::array::from_fn::<_, 3, _>(|j| rows[i][START + j]));
        for i in 0..3 {
            for j in 0..=i {
                let new = old[i][0] * g[(j, 0)] + old[i][1] * g[(j, 1)] + old[i][2] * g[(j, 2)];
                self.set(START + i, START + j, new);
            }
        }
        for j in (0..START).chain(START + 3..self.n.min(CAP)) {
            one_by_one();
            for i in START..START + 3 {
                self.p[j][i] = self.p[i][j];
            }
        }
    }

    /// Copies the lower triangle to the upper: symmetry is exact by construction.
    #[inline(always)]
    pub(crate) fn mirror<E: Eight>(&mut self) {
        for i in 0..self.n.div_ceil(LANES).min(CAP / LANES) {
            let (above, rows) = self.p.split_at_mut(i * LANES);
            for j in 0..i {
                let mut block = [E::splat(0.0); LANES];
                for (b, row) in block.iter_mut().zip(&*rows) {
                    *b = E::load(&lanes(row)[j]);
                }
                for (row, b) in above.iter_mut().skip(j * LANES).zip(E::transpose(block)) {
                    b.store(&mut lanes_mut(row)[i]);
                }
            }
            for k in 0..LANES {
                one_by_one();
                for l in 0..k {
                    rows[l][i * LANES + k] = rows[k][i * LANES + l];
                }
            }
        }
    }

    /// Verifies that all variances are finite and positive: what can be asked after every measurement.
    ///
    /// # Errors
    /// [`Error::Covariance`] with the first state that fails and its variance.
    pub(crate) fn check_variances(&self, t_ns: i64) -> Result<(), Error> {
        for (state, row) in self.p[..self.n.min(CAP)].iter().enumerate() {
            let variance = row[state];
            // NaN fails the comparison too
            if !(variance > 0.0 && variance < f64::INFINITY) {
                return Err(Error::Covariance { t_ns, state, pivot: variance });
            }
        }
        Ok(())
    }

    /// Verifies that P is finite and positive definite, by a factorisation of the correlation matrix.
    ///
    /// # Errors
    /// [`Error::Covariance`] with the first state that fails and its pivot (1 means uncorrelated).
    pub fn check(&self, t_ns: i64) -> Result<(), Error> {
        self.check_on(Isa::detect(), t_ns)
    }

    /// As [`Covariance::check`], on a given set of instructions.
    pub(crate) fn check_on(&self, isa: Isa, t_ns: i64) -> Result<(), Error> {
        self.check_variances(t_ns)?;
        match simd::run(isa, Check(self)) {
            None => Ok(()),
            Some((state, pivot)) => Err(Error::Covariance { t_ns, state, pivot }),
        }
    }
}

/// The factorisation L D L' of the correlation matrix as a kernel: the first pivot that is not positive.
struct Check<'a, const CAP: usize>(&'a Covariance<CAP>);

impl<const CAP: usize> Kernel for Check<'_, CAP> {
    type Output = Option<(usize, f64)>;

    #[inline(always)]
    fn run<E: Eight>(self) -> Option<(usize, f64)> {
        let (p, n) = (&self.0.p, self.0.len());
        let mut scale = Aligned([0.0; CAP]);
        for (i, s) in scale.0.iter_mut().enumerate().take(n) {
            *s = 1.0 / math::sqrt(p[i][i]);
        }
        let mut a = Aligned([[0.0; CAP]; CAP]);
        for ((a, p), s) in a.0.iter_mut().zip(p).zip(&scale.0).take(n) {
            for ((a, p), t) in lanes_mut(a).iter_mut().zip(lanes(p)).zip(lanes(&scale.0)) {
                E::load(p).times(E::load(t)).times(E::splat(*s)).store(a);
            }
        }
        for k in 0..n {
            let (done, rest) = a.0.split_at_mut((k + 1).min(CAP));
            let row = done.last()?;
            let pivot = row[k];
            if !(pivot.is_finite() && pivot > 0.0) {
                return Some((k, pivot));
            }
            let per_pivot = 1.0 / pivot;
            for (i, below) in (k + 1..n).zip(rest) {
                let factor = E::splat(-row[i] * per_pivot);
                for (b, r) in lanes_mut(below).iter_mut().zip(lanes(row)).skip(i / LANES) {
                    E::load(b).madd(factor, E::load(r)).store(b);
                }
            }
        }
        None
    }
}

/// The covariance prediction as a kernel.
struct Predict<'a, const CAP: usize> {
    cov: &'a mut Covariance<CAP>,
    t: &'a Transition<CAP>,
}

impl<const CAP: usize> Kernel for Predict<'_, CAP> {
    type Output = ();

    #[inline(always)]
    fn run<E: Eight>(self) {
        self.cov.add_half_noise(&self.t.blocks);
        self.cov.predict_kernel::<E>(self.t);
    }
}

/// The numbers of a row that are not zero: a row of an aid has a handful of them.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sparse<const CAP: usize> {
    index: [u8; CAP],
    value: [f64; CAP],
    len: usize,
}

impl<const CAP: usize> Sparse<CAP> {
    /// None.
    pub(crate) const EMPTY: Self = Self { index: [0; CAP], value: [0.0; CAP], len: 0 };

    pub(crate) fn of(h: &[f64; CAP]) -> Self {
        let mut sparse = Self::EMPTY;
        sparse.set::<Plain>(h);
        sparse
    }

    /// Becomes those of a row.
    #[inline(always)]
    pub(crate) fn set<E: Eight>(&mut self, h: &[f64; CAP]) {
        self.len = 0;
        for (tile, h) in lanes(h).iter().enumerate() {
            let mut left = E::load(h).nonzero();
            while left != 0 {
                let lane = left.trailing_zeros() as usize % LANES;
                left &= left - 1;
                if let (Some(index), Some(value)) =
                    (self.index.get_mut(self.len), self.value.get_mut(self.len))
                {
                    // no filter has 256 states
                    (*index, *value) = ((tile * LANES + lane) as u8, h[lane]);
                    self.len += 1;
                }
            }
        }
    }

    /// Multiplies all numbers.
    #[inline(always)]
    pub(crate) fn scale(&mut self, factor: f64) {
        for value in self.value.iter_mut().take(self.len) {
            *value *= factor;
        }
    }

    /// Places and values.
    #[inline(always)]
    fn iter(&self) -> impl Iterator<Item = (usize, f64)> {
        let len = self.len.min(CAP);
        self.index[..len].iter().zip(&self.value[..len]).map(|(j, h)| (usize::from(*j).min(CAP - 1), *h))
    }

    /// Scalar product with a full vector.
    #[inline(always)]
    pub(crate) fn dot<E: Eight>(&self, x: &[f64; CAP]) -> f64 {
        let mut sum = 0.0;
        for (j, h) in self.iter() {
            sum = madd::<E>(h, x[j], sum);
        }
        sum
    }
}

/// A row in tiles of eight.
#[inline(always)]
pub(crate) fn lanes<const CAP: usize>(row: &[f64; CAP]) -> &[Lanes] {
    row.as_chunks::<LANES>().0
}

#[inline(always)]
pub(crate) fn lanes_mut<const CAP: usize>(row: &mut [f64; CAP]) -> &mut [Lanes] {
    row.as_chunks_mut::<LANES>().0
}

/// Adds eight numbers to the first of a row.
#[inline(always)]
fn add_to_first<E: Eight, const CAP: usize>(row: &mut [f64; CAP], x: &Lanes) {
    if let Some(p) = lanes_mut(row).first_mut() {
        E::load(p).plus(E::load(x)).store(p);
    }
}

/// Scalar product.
#[inline(always)]
fn dot<E: Eight, const CAP: usize>(a: &[f64; CAP], b: &[f64; CAP]) -> f64 {
    let mut sum = E::splat(0.0);
    for (a, b) in lanes(a).iter().zip(lanes(b)) {
        sum = sum.madd(E::load(a), E::load(b));
    }
    sum.sum()
}

/// Some rows of [A B] times a matrix with `n` rows in use, eight columns of them.
#[inline(always)]
fn top_rows_times<E: Eight, const CAP: usize, const FIRST: usize, const COUNT: usize>(
    t: &Transition<CAP>,
    p: &[[f64; CAP]; CAP],
    n: usize,
    tile: usize,
    w: &mut [Lanes; NAV],
) {
    let mut sums = [E::splat(0.0); COUNT];
    let n = n.min(CAP);
    for ((row, column), &last) in p[..n].iter().zip(&t.columns.0[..n]).zip(&t.last.0[..n]) {
        let x = E::load(&lanes(row)[tile]);
        for (i, sum) in sums.iter_mut().enumerate() {
            let f = if FIRST + i == LAST { last } else { column[FIRST + i] };
            *sum = sum.madd(E::splat(f), x);
        }
    }
    for (w, sum) in w.iter_mut().skip(FIRST).zip(sums) {
        sum.store(w);
    }
}

/// Some of nine rows times [A B]', all columns but the last, in the place of their first eight numbers.
#[inline(always)]
fn rows_times_top<E: Eight, const CAP: usize, const FIRST: usize, const COUNT: usize>(
    rows: &mut [[f64; CAP]],
    t: &Transition<CAP>,
    n: usize,
) {
    let mut sums = [E::splat(0.0); COUNT];
    for (k, column) in t.columns.0[..n.min(CAP)].iter().enumerate() {
        let x = E::load(column);
        for (sum, row) in sums.iter_mut().zip(rows.iter().skip(FIRST)) {
            *sum = sum.madd(E::splat(row[k]), x);
        }
    }
    for (row, sum) in rows.iter_mut().skip(FIRST).zip(sums) {
        if let Some(p) = lanes_mut(row).first_mut() {
            sum.store(p);
        }
    }
}
