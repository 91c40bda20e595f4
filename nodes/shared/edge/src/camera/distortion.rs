use super::CalibrationError;

/// How a lens moves what lies at (x, y) = (X / Z, Y / Z); r is the distance of (x, y) from the axis. Coefficients in the order of
/// `sensor_msgs/CameraInfo`, formulas of OpenCV's documentation (`calib3d`; `fisheye`).
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Distortion {
    /// `plumb_bob` (k1, k2, p1, p2, k3; Brown 1966) and `rational_polynomial` (k4, k5, k6 behind): radial factor
    /// (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6), p1 and p2 tangential.
    Polynomial([f64; 8]),
    /// `equidistant` (k1 to k4; Kannala and Brandt 2006): theta (1 + k1 theta^2 + ... + k4 theta^8), theta the angle from the axis.
    Equidistant([f64; 4]),
}

impl Distortion {
    /// The distortion of a CameraInfo; `None` where there is none.
    ///
    /// # Errors
    /// When the model is unknown, has another number of coefficients, or one of them is not finite.
    pub fn new(model: &str, d: &[f64]) -> Result<Option<Self>, CalibrationError> {
        if let Some(index) = d.iter().position(|c| !c.is_finite()) {
            return Err(CalibrationError::NotFinite { field: "d", index, value: d[index] });
        }
        let straight = d.iter().all(|c| *c == 0.0);
        let counts: &[usize] = match model {
            "plumb_bob" => &[4, 5],
            "rational_polynomial" => &[8],
            "equidistant" => &[4],
            _ if straight => return Ok(None),
            unknown => return Err(CalibrationError::Model(unknown.to_owned())),
        };
        if d.is_empty() || (straight && model != "equidistant") {
            return Ok(None);
        }
        if !counts.contains(&d.len()) {
            return Err(CalibrationError::Coefficients { model: model.to_owned(), found: d.len(), needed: counts });
        }
        let at = |i: usize| d.get(i).copied().unwrap_or(0.0);
        Ok(Some(match model {
            "equidistant" => Self::Equidistant(std::array::from_fn(at)),
            _ => Self::Polynomial(std::array::from_fn(at)),
        }))
    }

    /// Where the lens shows what lies at (x, y).
    #[must_use]
    pub fn distort(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let r2 = x * x + y * y;
        match self {
            Self::Polynomial([k1, k2, p1, p2, k3, k4, k5, k6]) => {
                let radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
                [
                    x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                    y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
                ]
            }
            Self::Equidistant(_) => {
                let r = r2.sqrt();
                let scale = if r < 1e-8 { 1.0 } else { self.radial(r) / r };
                [x * scale, y * scale]
            }
        }
    }

    /// Distance from the axis at which the lens shows what lies at distance `r` from it, tangential parts left out; NaN where
    /// the formula has a pole.
    #[must_use]
    pub fn radial(&self, r: f64) -> f64 {
        let r2 = r * r;
        match self {
            Self::Polynomial([k1, k2, _, _, k3, k4, k5, k6]) => {
                let below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
                if below > 0.0 { r * (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / below } else { f64::NAN }
            }
            Self::Equidistant([k1, k2, k3, k4]) => {
                let theta = r.atan();
                let t2 = theta * theta;
                theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
            }
        }
    }

    /// The first distance from the axis, up to `r_max`, from which on the map goes back: there it is no lens any more.
    #[must_use]
    pub fn fold(&self, r_max: f64) -> Option<f64> {
        const STEPS: usize = 2048;
        let at = |i: usize| r_max * i as f64 / STEPS as f64;
        (0..STEPS)
            .find(|i| self.radial(at(i + 1)).partial_cmp(&self.radial(at(*i))) != Some(std::cmp::Ordering::Greater))
            .map(at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn models_have_their_numbers_of_coefficients() {
        for (model, counts) in [("plumb_bob", vec![4, 5]), ("rational_polynomial", vec![8]), ("equidistant", vec![4])] {
            for count in 1..15 {
                let found = Distortion::new(model, &vec![0.01; count]);
                assert_eq!(found.is_ok(), counts.contains(&count), "{model} {count}");
            }
        }
        let text = Distortion::new("plumb_bob", &[0.1; 3]).unwrap_err().to_string();
        assert!(text.contains("plumb_bob") && text.contains('3') && text.contains("[4, 5]"), "{text}");
    }

    #[test]
    fn no_distortion_is_none_but_a_fisheye_is_never_straight() {
        assert_eq!(Distortion::new("plumb_bob", &[0.0; 5]), Ok(None));
        assert_eq!(Distortion::new("", &[]), Ok(None));
        assert!(Distortion::new("equidistant", &[0.0; 4]).unwrap().is_some());
        assert!(Distortion::new("thin_prism", &[0.1; 4]).unwrap_err().to_string().contains("thin_prism"));
        assert!(Distortion::new("plumb_bob", &[0.1, f64::NAN, 0.0, 0.0]).unwrap_err().to_string().contains("d[1]"));
    }

    #[test]
    fn a_map_that_goes_back_says_where() {
        let barrel = Distortion::new("plumb_bob", &[-0.3, 0.0, 0.0, 0.0]).unwrap().unwrap();
        // d/dr (r - 0.3 r^3) = 0 at r = sqrt(1 / 0.9).
        let fold = barrel.fold(2.0).unwrap();
        assert!((fold - (1.0_f64 / 0.9).sqrt()).abs() < 2e-3, "{fold}");
        assert_eq!(barrel.fold(1.0), None);
        let pole = Distortion::new("rational_polynomial", &[0.1, 0.0, 0.0, 0.0, 0.0, -0.5, 0.0, 0.0]).unwrap().unwrap();
        assert!(pole.fold(2.0).is_some());
    }
}
