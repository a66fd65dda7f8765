//! sRGB to linear light and back, and means of colours.

use std::sync::LazyLock;

use crate::Rgb;

/// Linear light of each sRGB value, 0 to 1 (IEC 61966-2-1).
pub static LINEAR: LazyLock<[f32; 256]> = LazyLock::new(|| std::array::from_fn(|i| linear(i as f64) as f32));

/// Linear light half-way (in sRGB) between value `i` and the next: the least light that rounds to `i + 1`.
static STEPS: LazyLock<[f64; 255]> = LazyLock::new(|| std::array::from_fn(|i| linear(i as f64 + 0.5)));

/// Number of steps at or below `i / GUESSES`: where the search for a value starts.
static GUESS: LazyLock<[u8; GUESSES + 1]> =
    LazyLock::new(|| std::array::from_fn(|i| STEPS.partition_point(|&s| s <= i as f64 / GUESSES as f64) as u8));
const GUESSES: usize = 4096;

fn linear(value: f64) -> f64 {
    let v = value / 255.0;
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// The sRGB value nearest to `light` (0 to 1, clamped), the upper one half-way between two.
pub fn from_linear(light: f64) -> u8 {
    let light = light.clamp(0.0, 1.0);
    let mut value = GUESS[(light * GUESSES as f64) as usize] as usize;
    while value < 255 && STEPS[value] <= light {
        value += 1;
    }
    value as u8
}

/// A mean of colours in linear light.
#[derive(Clone, Copy, Debug, Default)]
pub struct Mean {
    sum: [f64; 3],
    n: u32,
}

impl Mean {
    #[inline]
    pub fn add(&mut self, color: Rgb) {
        for (sum, value) in self.sum.iter_mut().zip(color) {
            *sum += f64::from(LINEAR[value as usize]);
        }
        self.n += 1;
    }

    /// None before the first colour.
    pub fn get(&self) -> Option<Rgb> {
        (self.n > 0).then(|| self.sum.map(|sum| from_linear(sum / f64::from(self.n))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_values_survive_linear_light() {
        for value in 0..=255u8 {
            assert_eq!(from_linear(f64::from(LINEAR[value as usize])), value);
        }
    }

    #[test]
    fn srgb_rounds_to_the_nearest_value() {
        for i in 0..=100_000 {
            let light = f64::from(i) / 100_000.0;
            let encoded = if light <= 0.0031308 { light * 12.92 } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 };
            assert_eq!(from_linear(light), (encoded * 255.0).round() as u8, "light {light}");
        }
    }

    #[test]
    fn srgb_mean_of_black_and_white_is_half_the_light() {
        let mut mean = Mean::default();
        assert_eq!(mean.get(), None);
        mean.add([0, 255, 7]);
        mean.add([255, 255, 7]);
        assert_eq!(mean.get(), Some([188, 255, 7]));
    }
}
