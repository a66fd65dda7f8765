//! A source of tiles at the far end of a link: what it gives takes time to answer, and as long as its bytes need.

use std::fmt;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use planecast_encoder::{About, ColorMode, Encoding, Level, Result, TileKey, TileSource};

/// A link between tiles and who draws them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Link {
    /// Of all that is on its way at once; infinite for no limit.
    pub bytes_per_second: f64,
    /// From asking for a tile to its first byte. What is asked for meanwhile waits at the same time.
    pub latency: Duration,
}

impl Link {
    /// Nothing but the source itself takes time.
    pub const UNLIMITED: Link = Link { bytes_per_second: f64::INFINITY, latency: Duration::ZERO };

    pub fn new(megabits_per_second: f64, latency_ms: u64) -> Link {
        Link { bytes_per_second: megabits_per_second * 1e6 / 8.0, latency: Duration::from_millis(latency_ms) }
    }

    /// Seconds that so many bytes take once they come.
    fn passing(&self, bytes: u64) -> Duration {
        // A rate of 0 and one that is infinite times infinite are the ends of what a duration holds.
        Duration::try_from_secs_f64(bytes as f64 / self.bytes_per_second).unwrap_or(Duration::MAX)
    }
}

impl fmt::Display for Link {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let megabits = self.bytes_per_second * 8.0 / 1e6;
        match megabits {
            m if m.is_infinite() => f.write_str("unlimited"),
            m if m >= 1000.0 => write!(f, "{} Gbit/s", m / 1000.0),
            m => write!(f, "{m} Mbit/s"),
        }?;
        if self.latency > Duration::ZERO {
            write!(f, ", {} ms", self.latency.as_secs_f64() * 1e3)?;
        }
        Ok(())
    }
}

/// The time that a link keeps. Tests have one that they set.
pub trait Clock: Send + Sync {
    /// Since some moment before.
    fn now(&self) -> Duration;

    /// Returns once it is that late.
    fn wait_until(&self, at: Duration);
}

/// The time of the machine.
struct Time(Instant);

impl Clock for Time {
    fn now(&self) -> Duration {
        self.0.elapsed()
    }

    fn wait_until(&self, at: Duration) {
        std::thread::sleep(at.saturating_sub(self.now()));
    }
}

#[derive(Debug)]
struct State {
    link: Link,
    /// When all has passed that was asked for so far.
    free: Duration,
    bytes: u64,
}

impl State {
    /// When so many bytes are there that were asked for at some time: they follow what was asked for before.
    fn arrival(&mut self, asked: Duration, bytes: u64) -> Duration {
        self.bytes += bytes;
        let first = asked.saturating_add(self.link.latency).max(self.free);
        self.free = first.saturating_add(self.link.passing(bytes));
        self.free
    }
}

/// Tiles of a source, over a link that all who ask share.
pub struct Linked {
    source: Arc<dyn TileSource>,
    clock: Box<dyn Clock>,
    state: Mutex<State>,
}

impl Linked {
    /// Over a link without limits.
    pub fn new(source: Arc<dyn TileSource>) -> Linked {
        Linked::with_clock(source, Box::new(Time(Instant::now())))
    }

    pub fn with_clock(source: Arc<dyn TileSource>, clock: Box<dyn Clock>) -> Linked {
        let state = State { link: Link::UNLIMITED, free: Duration::ZERO, bytes: 0 };
        Linked { source, clock, state: Mutex::new(state) }
    }

    /// Another link from now on.
    pub fn set_link(&self, link: Link) {
        self.state.lock().expect("no holder panics").link = link;
    }

    /// Bytes that have been sent over it.
    pub fn sent(&self) -> u64 {
        self.state.lock().expect("no holder panics").bytes
    }

    /// Bytes of a tile as it is sent: as many as its file has for it, or as its lists take where it is made on the way.
    fn size(&self, key: TileKey, level: &Level) -> u64 {
        match self.source.bytes(key) {
            0 => level.solid.bytes() + level.exposed.as_ref().map_or(0, |e| e.bytes()) + 3 * level.colors.len() as u64,
            known => known,
        }
    }
}

impl TileSource for Linked {
    fn name(&self) -> String {
        self.source.name()
    }

    fn dims(&self) -> [u32; 3] {
        self.source.dims()
    }

    fn levels(&self) -> u32 {
        self.source.levels()
    }

    fn encoding(&self) -> Encoding {
        self.source.encoding()
    }

    fn color(&self) -> ColorMode {
        self.source.color()
    }

    fn about(&self) -> About {
        self.source.about()
    }

    fn heights(&self, level: u32) -> [u32; 2] {
        self.source.heights(level)
    }

    fn is_height_field(&self) -> bool {
        self.source.is_height_field()
    }

    fn start(&self) -> Option<[u32; 3]> {
        self.source.start()
    }

    fn is_empty(&self, key: TileKey) -> bool {
        self.source.is_empty(key)
    }

    fn tile(&self, key: TileKey) -> Result<Level> {
        let asked = self.clock.now();
        let tile = self.source.tile(key);
        // An error has no bytes, and comes as late as the first of others.
        let bytes = tile.as_ref().map_or(0, |level| self.size(key, level));
        let arrival = self.state.lock().expect("no holder panics").arrival(asked, bytes);
        self.clock.wait_until(arrival);
        tile
    }

    fn has_matter(&self) -> bool {
        self.source.has_matter()
    }

    fn bytes(&self, key: TileKey) -> u64 {
        self.source.bytes(key)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use planecast_encoder::producer;

    const MS: Duration = Duration::from_millis(1);

    fn state(link: Link) -> State {
        State { link, free: Duration::ZERO, bytes: 0 }
    }

    #[test]
    fn tiles_share_the_rate_and_wait_for_their_first_byte_side_by_side() {
        // 1,000 bytes a millisecond.
        let mut state = state(Link::new(8.0, 50));
        let arrivals = [(0, 10_000), (0, 20_000), (70, 1000), (71, 0), (500, 5000)]
            .map(|(asked, bytes)| state.arrival(asked * MS, bytes).as_millis());
        // The second follows the first; the third and fourth are asked for while these pass, and come 50 ms later than that;
        // what was idle in between is not made up for.
        assert_eq!(arrivals, [60, 80, 121, 121, 555]);
        assert_eq!(state.bytes, 36_000);
    }

    #[test]
    fn links_without_end_keep_to_what_a_duration_holds() {
        assert_eq!(state(Link::UNLIMITED).arrival(7 * MS, u64::MAX), 7 * MS);
        for link in [
            Link { bytes_per_second: 0.0, latency: MS },
            Link { latency: Duration::MAX, ..Link::UNLIMITED },
            Link { bytes_per_second: 1e-300, latency: MS },
        ] {
            assert_eq!(state(link).arrival(MS, 1), Duration::MAX, "{link:?}");
        }
    }

    #[test]
    fn links_say_what_they_are() {
        let links = [Link::UNLIMITED, Link::new(1000.0, 1), Link::new(2500.0, 0), Link::new(100.0, 50)];
        let expected = ["unlimited", "1 Gbit/s, 1 ms", "2.5 Gbit/s", "100 Mbit/s, 50 ms"];
        assert_eq!(links.map(|link| link.to_string()), expected);
    }

    /// A clock that goes as far as it is waited for.
    struct Told(Arc<Mutex<Vec<Duration>>>);

    impl Clock for Told {
        fn now(&self) -> Duration {
            self.0.lock().unwrap().last().copied().unwrap_or_default()
        }

        fn wait_until(&self, at: Duration) {
            self.0.lock().unwrap().push(at);
        }
    }

    #[test]
    fn each_tile_waits_until_its_bytes_are_there() {
        let source = producer::from_name("menger?size=3^6").unwrap().unwrap();
        let waits = Arc::new(Mutex::new(Vec::new()));
        let linked = Linked::with_clock(Arc::clone(&source), Box::new(Told(Arc::clone(&waits))));
        let key = TileKey { level: 1, x: 0, z: 0 };
        assert!(linked.tile(key).unwrap() == source.tile(key).unwrap());
        let bytes = linked.sent();
        assert!(bytes > 4 * 65_536, "{bytes}");
        linked.set_link(Link { bytes_per_second: bytes as f64, latency: 50 * MS });
        linked.tile(key).unwrap();
        linked.tile(key).unwrap();
        // There is none: nothing passes.
        linked.tile(TileKey { level: 1, x: 99, z: 0 }).unwrap_err();
        let second = Duration::from_secs(1);
        assert_eq!(
            *waits.lock().unwrap(),
            [Duration::ZERO, second + 50 * MS, 2 * (second + 50 * MS), 2 * second + 150 * MS]
        );
        assert_eq!(linked.sent(), 3 * bytes);
    }
}
