//! IMU rows in blocks: copied while the GIL is held, used while it is released. Nothing borrowed outlives the copy, and
//! one block of memory serves a log of any length.

use nalgebra::Vector3;
use numpy::ndarray::s;
use numpy::{Element, PyArray1, PyArray2, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::{convert, errors};

/// Rows of a block, which is also how often signals and the progress callback are looked at.
const BLOCK_ROWS: usize = 16_384;
/// Rows from which on it pays to release the GIL.
const RELEASE_ROWS: usize = 64;

/// Columns of IMU rows, checked for type and shape.
pub struct ImuColumns<'py> {
    t_ns: Bound<'py, PyArray1<i64>>,
    gyro: Bound<'py, PyArray2<f64>>,
    accel: Bound<'py, PyArray2<f64>>,
}

/// Owned rows.
#[derive(Debug, Default)]
pub struct Block {
    t_ns: Vec<i64>,
    gyro: Vec<f64>,
    accel: Vec<f64>,
}

impl<'py> ImuColumns<'py> {
    pub fn new(
        t_ns: &Bound<'py, PyAny>,
        gyro: &Bound<'py, PyAny>,
        accel: &Bound<'py, PyAny>,
    ) -> PyResult<Self> {
        let columns = Self {
            t_ns: convert::time_column(t_ns, "imu_t_ns")?,
            gyro: convert::table3(gyro, "gyro")?,
            accel: convert::table3(accel, "accel")?,
        };
        let lengths = [columns.t_ns.len(), columns.gyro.shape()[0], columns.accel.shape()[0]];
        convert::same_length(t_ns.py(), "IMU table", &lengths)?;
        Ok(columns)
    }

    pub fn len(&self) -> usize {
        self.t_ns.len()
    }

    /// First and last stamp.
    pub fn span_ns(&self) -> Option<(i64, i64)> {
        Some((self.t_ns.get_owned([0])?, self.t_ns.get_owned([self.len().checked_sub(1)?])?))
    }

    /// Copies the rows block by block and hands them over with the number of the first; `use_rows` runs without the GIL.
    ///
    /// `between` is called with the share done before each block; Ctrl-C goes through there.
    pub fn in_blocks<F>(&self, mut between: impl FnMut(f64) -> PyResult<()>, mut use_rows: F) -> PyResult<()>
    where
        F: FnMut(usize, &Block) -> PyResult<()> + Send,
    {
        let (py, rows) = (self.t_ns.py(), self.len());
        let mut block = Block::default();
        for first in (0..rows).step_by(BLOCK_ROWS) {
            between(first as f64 / rows as f64)?;
            let last = rows.min(first + BLOCK_ROWS);
            self.copy(first, last, &mut block)?;
            if last - first < RELEASE_ROWS {
                use_rows(first, &block)?;
            } else {
                py.detach(|| use_rows(first, &block))?;
            }
        }
        Ok(())
    }

    fn copy(&self, first: usize, last: usize, block: &mut Block) -> PyResult<()> {
        let py = self.t_ns.py();
        // between two blocks another thread may have resized an array in place
        if [self.t_ns.len(), self.gyro.shape()[0], self.accel.shape()[0]].iter().any(|n| *n < last) {
            return Err(errors::input(
                py,
                "input.shape",
                "IMU table: an array became shorter during the run",
                "hand over a copy",
            ));
        }
        copy_column(&self.t_ns, first, last, &mut block.t_ns)?;
        copy_rows(&self.gyro, first, last, &mut block.gyro)?;
        copy_rows(&self.accel, first, last, &mut block.accel)
    }
}

fn copy_column<T: Element + Copy>(
    array: &Bound<'_, PyArray1<T>>,
    first: usize,
    last: usize,
    out: &mut Vec<T>,
) -> PyResult<()> {
    let view = array.try_readonly()?;
    out.clear();
    match view.as_slice() {
        Ok(values) => out.extend_from_slice(&values[first..last]),
        Err(_) => out.extend(view.as_array().slice(s![first..last]).iter().copied()),
    }
    Ok(())
}

fn copy_rows(
    array: &Bound<'_, PyArray2<f64>>,
    first: usize,
    last: usize,
    out: &mut Vec<f64>,
) -> PyResult<()> {
    let view = array.try_readonly()?;
    out.clear();
    match view.as_slice() {
        // C order only: the transpose of a contiguous array is contiguous too
        Ok(values) if array.is_c_contiguous() => out.extend_from_slice(&values[3 * first..3 * last]),
        _ => out.extend(view.as_array().slice(s![first..last, ..]).iter().copied()),
    }
    Ok(())
}

impl Block {
    /// Stamps, gyro and accelerometer values.
    pub fn rows(&self) -> impl Iterator<Item = (i64, Vector3<f64>, Vector3<f64>)> {
        let vectors = |values| <[f64]>::chunks_exact(values, 3).map(|c| Vector3::new(c[0], c[1], c[2]));
        let sensors = vectors(&self.gyro).zip(vectors(&self.accel));
        self.t_ns.iter().zip(sensors).map(|(t_ns, (gyro, accel))| (*t_ns, gyro, accel))
    }

    /// Places of the rows that hold NaN or infinity.
    pub fn bad_rows(&self) -> impl Iterator<Item = usize> {
        self.rows()
            .enumerate()
            .filter(|(_, (_, gyro, accel))| gyro.iter().chain(accel).any(|x| !x.is_finite()))
            .map(|(row, _)| row)
    }
}
