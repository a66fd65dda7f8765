//! What a scene file says beside its voxels, between header and directory ([`crate::format`] has the byte map).

use std::sync::Arc;

use bytemuck::{Pod, Zeroable, bytes_of, pod_read_unaligned};
use xxhash_rust::xxh3::xxh3_64;

use crate::About;
use crate::format::ALIGN;
use crate::model::matter::Classes;

/// Tag of the section that holds an [`About`].
const ABOUT: [u8; 4] = *b"ABUT";

/// Tag of the section that holds [`About::fractions`].
const FRACTIONS: [u8; 4] = *b"FRAC";

/// Tag of the section that holds [`About::classes`].
const CLASSES: [u8; 4] = *b"CLAS";

/// Bytes of an [`About`] at most: it is text for people.
const MAX_ABOUT: usize = 1 << 20;

#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
struct ChunkHeader {
    tag: [u8; 4],
    /// Bytes that follow, without the zeros that fill up to a multiple of 16.
    len: u32,
    /// xxh3-64 of these bytes.
    checksum: u64,
}

/// The sections of a file of which this is known: none where it is nothing.
pub fn pack(about: &About) -> Vec<u8> {
    let finite = |values: &[f64]| values.iter().all(|v| v.is_finite());
    // JSON has no other numbers.
    let mut about = about.clone();
    about.voxel = about.voxel.filter(|v| finite(v));
    about.values = about.values.filter(|v| finite(v));
    about.affine = about.affine.filter(|rows| finite(rows.as_flattened()));
    let mut bytes = Vec::new();
    let mut section = |tag: [u8; 4], content: &[u8]| {
        let Ok(len) = u32::try_from(content.len()) else { return };
        bytes.extend_from_slice(bytes_of(&ChunkHeader { tag, len, checksum: xxh3_64(content) }));
        bytes.extend_from_slice(content);
        bytes.resize(bytes.len().next_multiple_of(ALIGN as usize), 0);
    };
    let (fractions, classes) = (std::mem::take(&mut about.fractions), about.classes.take());
    if about != About::default() {
        let text = serde_json::to_vec(&about).expect("plain values have a JSON form");
        if text.len() <= MAX_ABOUT {
            section(ABOUT, &text);
        }
    }
    if !fractions.is_empty() {
        section(FRACTIONS, &fractions);
    }
    if let Some(classes) = classes {
        section(CLASSES, &serde_json::to_vec(&*classes).expect("finite values have a JSON form"));
    }
    bytes
}

/// Bytes of the first section with what fills it up, from its header; it says most. 0 where there is none.
pub fn first(header: &[u8]) -> u64 {
    let header = header.get(..size_of::<ChunkHeader>()).map(pod_read_unaligned::<ChunkHeader>);
    let header = header.filter(|h| h.tag == ABOUT && h.len as usize <= MAX_ABOUT);
    header.map_or(0, |h| (size_of::<ChunkHeader>() as u64 + u64::from(h.len)).next_multiple_of(ALIGN))
}

/// What sections say; those that are not known are passed over. An error names the byte, from the sections' start.
pub fn unpack(bytes: &[u8]) -> Result<About, (usize, String)> {
    let (mut at, mut about) = (0, About::default());
    while let Some(header) = bytes.get(at..at + size_of::<ChunkHeader>()) {
        let header: ChunkHeader = pod_read_unaligned(header);
        let from = at + size_of::<ChunkHeader>();
        let end = from.saturating_add(header.len as usize);
        let Some(content) = bytes.get(from..end) else {
            return Err((at, format!("a section of {} bytes, {} are left", header.len, bytes.len() - from)));
        };
        if xxh3_64(content) != header.checksum {
            return Err((at, "a section does not match its checksum; the file is damaged".to_owned()));
        }
        if header.tag == ABOUT {
            let (fractions, classes) = (std::mem::take(&mut about.fractions), about.classes.take());
            about = serde_json::from_slice(content).map_err(|e| (from, format!("says what it is not as JSON: {e}")))?;
            about.clean();
            (about.fractions, about.classes) = (fractions, classes);
        }
        if header.tag == FRACTIONS {
            about.fractions = content.into();
        }
        if header.tag == CLASSES {
            let classes: Classes =
                serde_json::from_slice(content).map_err(|e| (from, format!("classes that are not JSON: {e}")))?;
            classes.check().map_err(|what| (from, what))?;
            about.classes = Some(Arc::new(classes));
        }
        let next = end.next_multiple_of(ALIGN as usize);
        if bytes.get(end..next).is_none_or(|fill| fill.iter().any(|b| *b != 0)) {
            return Err((end, "zeros were expected behind a section; the file is damaged".to_owned()));
        }
        at = next;
    }
    match bytes.len() - at {
        0 => Ok(about),
        n => Err((at, format!("{n} bytes behind the last section; the file is damaged"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::about::Kind;

    fn about() -> About {
        About {
            voxel: Some([30.0, 0.5, 30.0]),
            unit: "m".to_owned(),
            values: Some([-12.5, 1e9]),
            left_out: vec!["2 overviews".to_owned()],
            ..About::new(Kind::Terrain, "GeoTIFF")
        }
    }

    #[test]
    fn metadata_comes_back_and_nothing_takes_no_bytes() {
        assert_eq!(unpack(&pack(&about())), Ok(about()));
        assert!(pack(&About::default()).is_empty());
        assert_eq!(unpack(&[]), Ok(About::default()));
        let endless = About { values: Some([0.0, f64::INFINITY]), ..about() };
        assert_eq!(unpack(&pack(&endless)), Ok(About { values: None, ..about() }));
    }

    #[test]
    fn metadata_keeps_fractions_with_and_without_more() {
        for about in [about(), About::default()] {
            let about = About { fractions: vec![128, 0, 255, 7, 130].into(), ..about };
            assert_eq!(unpack(&pack(&about)), Ok(about));
        }
    }

    #[test]
    fn metadata_of_another_kind_is_passed_over() {
        let other = ChunkHeader { tag: *b"NEW ", len: 3, checksum: xxh3_64(b"abc") };
        let bytes = [bytes_of(&other), b"abc", &[0; 13], &pack(&about())].concat();
        assert_eq!(unpack(&bytes), Ok(about()));
    }

    #[test]
    fn metadata_with_any_byte_changed_is_refused_or_says_the_same() {
        let bytes = pack(&about());
        for at in 0..bytes.len() {
            let mut wrong = bytes.clone();
            wrong[at] ^= 0x41;
            // A tag that is not known is passed over, whatever it should have been.
            assert!(unpack(&wrong).is_err() || at < 4, "byte {at}");
            assert!(unpack(&bytes[..at]).is_err() || at == 0, "cut at {at}");
        }
    }

    #[test]
    fn metadata_cannot_command_a_terminal() {
        let evil = About { crs: "EPSG:\u{1b}[2J1".to_owned(), ..about() };
        assert_eq!(unpack(&pack(&evil)).unwrap().crs, "EPSG:[2J1");
    }
}
