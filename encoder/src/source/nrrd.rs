//! NRRD volumes.

use std::path::Path;

use super::volume::{Data, Stored, Volume, byte_len, gunzip};
use super::{Dtype, ReadOptions, map};
use crate::{Error, Result};

/// NRRD: text header, values raw or gzip, in the same file or a detached one.
pub(super) fn read<'a>(path: &Path, bytes: &'a [u8], opts: &ReadOptions) -> Result<Volume<'a>> {
    let fail = |at: usize, what: String| Err(Error::format(path, format!("byte {at}: {what}")));
    if !bytes.starts_with(b"NRRD000") {
        return fail(0, "expected the NRRD signature NRRD000".to_owned());
    }
    let mut header = NrrdHeader::default();
    let mut at = 0;
    // The header ends with an empty line; a detached one may end with its file.
    let header_end = loop {
        let Some(len) = bytes[at..].iter().position(|&b| b == b'\n') else {
            if bytes.len() - at > 0 && header.data_file.is_none() {
                return fail(at, "the file ends inside the NRRD header".to_owned());
            }
            break bytes.len();
        };
        let line = String::from_utf8_lossy(&bytes[at..at + len]);
        let line = line.trim_end();
        if line.is_empty() {
            break at + len + 1;
        }
        if at > 0
            && let Err(what) = header.field(line)
        {
            return fail(at, what);
        }
        at += len + 1;
    };
    let missing = |what| Error::format(path, format!("byte {header_end}: the NRRD header ends without \"{what}\""));
    let dtype = header.dtype.ok_or_else(|| missing("type"))?;
    let encoding = header.encoding.clone().ok_or_else(|| missing("encoding"))?;
    let mut sizes = header.sizes.clone().ok_or_else(|| missing("sizes"))?;
    if header.dimension.is_some_and(|d| d != sizes.len()) {
        return fail(0, format!("dimension is {} but there are {} sizes", header.dimension.unwrap_or(0), sizes.len()));
    }
    if sizes.len() > 3 {
        sizes.retain(|&n| n != 1);
    }
    let &[x, y, z] = sizes.as_slice() else {
        return fail(
            0,
            format!("sizes {:?}: expected three axes, one value a voxel", header.sizes.unwrap_or_default()),
        );
    };
    let dims = [x, y, z];
    let expected = byte_len(path, dims, dtype)?;
    if dtype.size() > 1 && header.big_endian.is_none() {
        return Err(missing("endian"));
    }

    let detached = header.data_file.as_ref().map(|name| path.parent().unwrap_or(Path::new("")).join(name));
    let detached = detached.map(|path| Ok((map(&path)?, path))).transpose()?;
    let (data_path, mut data) = match &detached {
        Some((bytes, path)) => (path.clone(), &**bytes),
        None => (path.to_owned(), &bytes[header_end..]),
    };
    for _ in 0..header.line_skip {
        let Some(len) = data.iter().position(|&b| b == b'\n') else {
            return Err(Error::format(data_path, format!("fewer lines than \"line skip: {}\"", header.line_skip)));
        };
        data = &data[len + 1..];
    }
    let short = |got: usize| {
        Error::format(&data_path, format!("{got} bytes of values; {x} × {y} × {z} of this type expect {expected}"))
    };
    let values = match encoding.as_str() {
        "raw" => {
            let skip = match header.byte_skip {
                -1 => (data.len() as u64).checked_sub(expected).ok_or_else(|| short(data.len()))?,
                n => n as u64,
            };
            let end =
                skip.checked_add(expected).filter(|&e| e <= data.len() as u64).ok_or_else(|| short(data.len()))?;
            let values = &data[skip as usize..end as usize];
            match &detached {
                Some((whole, path)) => Data::Slice(values).in_file(path, whole)?,
                // The same bytes, as a part of `bytes`, which live longer.
                None => Data::Slice(&bytes[bytes.len() - data.len()..][skip as usize..end as usize]),
            }
        }
        "gzip" | "gz" => {
            let skip = header.byte_skip.max(0) as u64;
            let end = skip.checked_add(expected).ok_or_else(|| short(0))?;
            gunzip(&data_path, data, skip, end)?.map_err(|got| short(got as usize))?
        }
        other => {
            return fail(0, format!("encoding {other:?} is not supported; save it as raw or gzip (unu save -e gzip)"));
        }
    };
    let mut notes = header.notes;
    notes.push(
        "NRRD axes are kept as stored: the first is x, the second y, the third z (--up z to stand on the third)"
            .to_owned(),
    );
    let big_endian = header.big_endian == Some(true);
    let stored = Stored { big_endian, notes, ..Stored::new(dims, dtype, values) };
    Volume::new(path, stored, opts)
}

#[derive(Default)]
struct NrrdHeader {
    dtype: Option<Dtype>,
    dimension: Option<usize>,
    sizes: Option<Vec<u64>>,
    encoding: Option<String>,
    big_endian: Option<bool>,
    data_file: Option<String>,
    line_skip: u64,
    byte_skip: i64,
    notes: Vec<String>,
}

impl NrrdHeader {
    /// Takes in one line after the signature.
    fn field(&mut self, line: &str) -> Result<(), String> {
        if line.starts_with('#') || line.contains(":=") {
            return Ok(());
        }
        let (name, value) = line.split_once(':').ok_or_else(|| format!("expected \"field: value\", found {line:?}"))?;
        let value = value.trim();
        let bad = || format!("\"{}\" has the value {value:?}", name.trim());
        match name.trim().to_lowercase().as_str() {
            "type" => {
                self.dtype = Some(match value {
                    "uchar" | "unsigned char" | "uint8" | "uint8_t" => Dtype::U8,
                    "signed char" | "int8" | "int8_t" => Dtype::I8,
                    "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => Dtype::U16,
                    "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => Dtype::I16,
                    "uint" | "unsigned int" | "uint32" | "uint32_t" => Dtype::U32,
                    "int" | "signed int" | "int32" | "int32_t" => Dtype::I32,
                    "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64" | "uint64_t" => Dtype::U64,
                    "longlong"
                    | "long long"
                    | "long long int"
                    | "signed long long"
                    | "signed long long int"
                    | "int64"
                    | "int64_t" => Dtype::I64,
                    "float" => Dtype::F32,
                    "double" => Dtype::F64,
                    _ => return Err(format!("{}; expected an integer type, float or double", bad())),
                });
            }
            "dimension" => self.dimension = Some(value.parse().map_err(|_| bad())?),
            "sizes" => {
                let sizes: Result<Vec<u64>, _> = value.split_whitespace().map(str::parse).collect();
                self.sizes = Some(sizes.map_err(|_| bad())?);
            }
            "encoding" => self.encoding = Some(value.to_lowercase()),
            "endian" => {
                self.big_endian = Some(match value {
                    "little" => false,
                    "big" => true,
                    _ => return Err(bad()),
                });
            }
            "data file" | "datafile" => {
                if value.starts_with("LIST") || value.contains('%') {
                    return Err(format!("{}; values spread over several files are not supported", bad()));
                }
                self.data_file = Some(value.to_owned());
            }
            "line skip" | "lineskip" => self.line_skip = value.parse().map_err(|_| bad())?,
            "byte skip" | "byteskip" => {
                self.byte_skip = value.parse().ok().filter(|&n| n >= -1).ok_or_else(bad)?;
            }
            "spacings" | "space directions" => {
                self.notes.push(format!("{}: {value}; voxels are drawn as cubes", name.trim()))
            }
            // Further fields say nothing about where the values are.
            _ => {}
        }
        Ok(())
    }
}
