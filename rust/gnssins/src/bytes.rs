//! Little-endian reading and writing of saved states without a heap.

use crate::error::Error;

/// Writes numbers into a buffer.
#[derive(Debug)]
pub struct Writer<'a> {
    buffer: &'a mut [u8],
    len: usize,
}

impl<'a> Writer<'a> {
    /// Starts at the beginning of a buffer.
    #[must_use]
    pub fn new(buffer: &'a mut [u8]) -> Self {
        Self { buffer, len: 0 }
    }

    /// Bytes written.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.len
    }

    /// True before the first number.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    fn put(&mut self, bytes: [u8; 8]) -> Result<(), Error> {
        let got = self.buffer.len() as u64;
        let slot = self.buffer.get_mut(self.len..self.len + 8).ok_or(Error::SavedState {
            what: "buffer length in bytes",
            need: self.len as u64 + 8,
            got,
        })?;
        slot.copy_from_slice(&bytes);
        self.len += 8;
        Ok(())
    }

    /// Writes an unsigned number.
    ///
    /// # Errors
    /// [`Error::SavedState`] when the buffer is full; so do the others.
    pub fn u64(&mut self, v: u64) -> Result<(), Error> {
        self.put(v.to_le_bytes())
    }

    /// Writes a signed number.
    ///
    /// # Errors
    /// As [`Writer::u64`].
    pub fn i64(&mut self, v: i64) -> Result<(), Error> {
        self.put(v.to_le_bytes())
    }

    /// Writes numbers bit by bit.
    ///
    /// # Errors
    /// As [`Writer::u64`].
    pub fn f64s(&mut self, values: &[f64]) -> Result<(), Error> {
        values.iter().try_for_each(|v| self.put(v.to_bits().to_le_bytes()))
    }
}

/// Reads what a [`Writer`] wrote.
#[derive(Debug)]
pub struct Reader<'a> {
    buffer: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    /// Starts at the beginning of a buffer.
    #[must_use]
    pub const fn new(buffer: &'a [u8]) -> Self {
        Self { buffer, at: 0 }
    }

    fn take(&mut self) -> Result<[u8; 8], Error> {
        let bytes = self.buffer.get(self.at..self.at + 8).and_then(|s| s.try_into().ok()).ok_or(
            Error::SavedState {
                what: "length in bytes",
                need: self.at as u64 + 8,
                got: self.buffer.len() as u64,
            },
        )?;
        self.at += 8;
        Ok(bytes)
    }

    /// Reads an unsigned number.
    ///
    /// # Errors
    /// [`Error::SavedState`] when the bytes end; so do the others.
    pub fn u64(&mut self) -> Result<u64, Error> {
        Ok(u64::from_le_bytes(self.take()?))
    }

    /// Reads an unsigned number that must be `need`.
    ///
    /// # Errors
    /// [`Error::SavedState`] when it is another.
    pub fn expect(&mut self, what: &'static str, need: u64) -> Result<(), Error> {
        let got = self.u64()?;
        if got == need { Ok(()) } else { Err(Error::SavedState { what, need, got }) }
    }

    /// The next word as a flag.
    ///
    /// # Errors
    /// [`Error::SavedState`] for anything but 0 and 1.
    pub fn flag(&mut self) -> Result<bool, Error> {
        match self.u64()? {
            0 => Ok(false),
            1 => Ok(true),
            got => Err(Error::SavedState { what: "a flag", need: 1, got }),
        }
    }

    /// Reads a signed number.
    ///
    /// # Errors
    /// As [`Reader::u64`].
    pub fn i64(&mut self) -> Result<i64, Error> {
        Ok(i64::from_le_bytes(self.take()?))
    }

    /// Reads one number.
    ///
    /// # Errors
    /// As [`Reader::u64`].
    pub fn f64(&mut self) -> Result<f64, Error> {
        Ok(f64::from_bits(self.u64()?))
    }

    /// Fills a slice.
    ///
    /// # Errors
    /// As [`Reader::u64`].
    pub fn f64s(&mut self, out: &mut [f64]) -> Result<(), Error> {
        out.iter_mut().try_for_each(|v| {
            *v = self.f64()?;
            Ok(())
        })
    }
}
