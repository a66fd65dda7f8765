//! How much memory there is, and how much is used.

/// Bytes that can be had without pushing others out, and within what `ulimit -v` and `-d` leave; None where the system does not
/// say.
pub fn available() -> Option<u64> {
    let free = proc_kib("/proc/meminfo", "MemAvailable:");
    [free, left_of_limits()].into_iter().flatten().min()
}

/// Bytes that this process may still ask for; None without a limit.
#[cfg(target_os = "linux")]
pub fn left_of_limits() -> Option<u64> {
    let left = |limit: Option<u64>, used: &str| Some(limit?.saturating_sub(proc_kib("/proc/self/status", used)?));
    let space = left(limit(libc::RLIMIT_AS), "VmSize:");
    [space, left(limit(libc::RLIMIT_DATA), "VmData:")].into_iter().flatten().min()
}

#[cfg(target_os = "linux")]
fn limit(which: libc::__rlimit_resource_t) -> Option<u64> {
    let mut limit = libc::rlimit { rlim_cur: libc::RLIM_INFINITY, rlim_max: libc::RLIM_INFINITY };
    // SAFETY: a place for what it answers.
    let known = unsafe { libc::getrlimit(which, &mut limit) } == 0;
    (known && limit.rlim_cur != libc::RLIM_INFINITY).then_some(limit.rlim_cur)
}

#[cfg(not(target_os = "linux"))]
pub fn left_of_limits() -> Option<u64> {
    None
}

/// Bytes that this process holds of its own, files it has mapped left out.
pub fn used() -> Option<u64> {
    proc_kib("/proc/self/status", "RssAnon:")
}

/// The most that this process ever held, mapped files included.
pub fn peak() -> Option<u64> {
    proc_kib("/proc/self/status", "VmHWM:")
}

fn proc_kib(file: &str, field: &str) -> Option<u64> {
    let text = std::fs::read_to_string(file).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(field))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib << 10)
}

/// Bytes from text such as `512M`, `4G`, `1.5GiB`, `100000`; units are powers of 1024.
pub fn parse(text: &str) -> Result<u64, String> {
    let wrong = || "expected a size of at least 1M, as in 512M or 4G".to_owned();
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let shift = match text[digits.len()..].to_ascii_lowercase().as_str() {
        "" | "b" => 0,
        "k" | "kb" | "kib" => 10,
        "m" | "mb" | "mib" => 20,
        "g" | "gb" | "gib" => 30,
        "t" | "tb" | "tib" => 40,
        _ => return Err(wrong()),
    };
    let number: f64 = digits.parse().map_err(|_| wrong())?;
    let bytes = number * (1u64 << shift) as f64;
    if (f64::from(1 << 20)..1e18).contains(&bytes) { Ok(bytes as u64) } else { Err(wrong()) }
}

/// Bytes as a person reads them.
pub fn display(bytes: u64) -> String {
    let (unit, shift) = match bytes {
        0..1024 => return format!("{bytes} B"),
        1024..0x10_0000 => ("KiB", 10),
        0x10_0000..0x4000_0000 => ("MiB", 20),
        _ => ("GiB", 30),
    };
    format!("{:.1} {unit}", bytes as f64 / (1u64 << shift) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_sizes_are_read_with_their_units() {
        assert_eq!(parse("512M"), Ok(512 << 20));
        assert_eq!(parse("1.5GiB"), Ok(3 << 29));
        assert_eq!(parse("2097152"), Ok(2 << 20));
        for wrong in ["", "M", "0", "12", "-4G", "4X", "nan", "1e30G", "4 G G"] {
            assert!(parse(wrong).is_err(), "{wrong:?}");
        }
    }

    #[test]
    fn memory_sizes_are_written_with_a_unit() {
        assert_eq!([5, 2048, 3 << 20, 5 << 29].map(display), ["5 B", "2.0 KiB", "3.0 MiB", "2.5 GiB"]);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn memory_figures_are_known_and_ordered() {
        let (used, peak) = (used().unwrap(), peak().unwrap());
        assert!(used > 0 && used <= peak && available().unwrap() > 0, "{used} {peak}");
    }
}
