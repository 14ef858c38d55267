//! Projections of a texture: texture coordinates to points of the world, and rays to texture coordinates.

use crate::shell::support::vectors::{Rotation, WorldVector, atan2, dot, sin_cos};

/// Correspondence of texture coordinates and directions.
#[derive(Debug, Clone)]
pub(super) enum Surface {
    /// Picture plane of a pinhole camera at the origin, turned by the rotation (picture to world).
    Tangent(Rotation),
    /// Azimuth and elevation about the axes of the rotation.
    Sphere(Rotation),
    /// The ground, seen from this height, metres.
    Ground(f64),
}

/// A textured surface with relief. Relief 0 is at infinity (or the ground), relief 1 has inverse depth `reach` (or height
/// `reach` above the ground).
#[derive(Debug, Clone)]
pub(super) struct Projection {
    pub form: Surface,
    /// Texture pixels for one unit of the form: tangent, radian or metre.
    pub scale: f64,
    /// Texture coordinates of the form's origin.
    pub centre: [f64; 2],
    /// Inverse depth of relief 1, 1/m; of [`Surface::Ground`] its height, m.
    pub reach: f64,
}

impl Projection {
    /// Texture coordinates that are seen along `direction` from `position`, if the surface had this relief everywhere;
    /// `None` where the ray misses it.
    pub(super) fn place(
        &self,
        direction: WorldVector,
        position: WorldVector,
        relief: f64,
    ) -> Option<[f64; 2]> {
        let [x, y] = match &self.form {
            Surface::Ground(height) => {
                let depth = height - position[1] - relief * self.reach;
                if direction[1] <= 0.02 || depth <= 0.0 {
                    return None;
                }
                let scale = depth / direction[1];
                [position[0] + direction[0] * scale, -position[2] - direction[2] * scale]
            }
            Surface::Tangent(axes) | Surface::Sphere(axes) => {
                // Where the ray leaves the sphere of constant distance 1 / inverse about the origin.
                let inverse = relief * self.reach;
                let length = dot(direction, direction).sqrt();
                let unit = direction.map(|v| v / length);
                let along = inverse * dot(unit, position);
                let across = inverse * inverse * dot(position, position) - along * along;
                let forward = (1.0 - across).max(0.01).sqrt() - along;
                let seen: WorldVector =
                    core::array::from_fn(|i| unit[i] * forward + inverse * position[i]);
                let [x, y, z] = axes.invert(seen);
                if let Surface::Tangent(_) = self.form {
                    if z < 0.05 {
                        return None;
                    }
                    [x / z, y / z]
                } else {
                    [atan2(x, z), atan2(y, (x * x + z * z).sqrt())]
                }
            }
        };
        Some([self.centre[0] + self.scale * x, self.centre[1] + self.scale * y])
    }

    /// The point of the surface at these texture coordinates: direction from the origin times depth is
    /// `direction / inverse`, or the direction alone where the inverse depth is 0.
    pub(super) fn point(&self, place: [f64; 2], relief: f64) -> (WorldVector, f64) {
        let [x, y] = [0, 1].map(|i: usize| (place[i] - self.centre[i]) / self.scale);
        match &self.form {
            Surface::Ground(height) => ([x, height - relief * self.reach, -y], 1.0),
            Surface::Tangent(axes) => {
                let length = (x * x + y * y + 1.0).sqrt();
                (axes.apply([x / length, y / length, 1.0 / length]), relief * self.reach)
            }
            Surface::Sphere(axes) => {
                let ((sa, ca), (se, ce)) = (sin_cos(x), sin_cos(y));
                (axes.apply([sa * ce, se, ca * ce]), relief * self.reach)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn forms() -> [Projection; 3] {
        let axes = Rotation::new(0.3, -0.2, 0.1);
        let surface =
            |form, scale, reach| Projection { form, scale, centre: [400.0, 300.0], reach };
        [
            surface(Surface::Tangent(axes), 560.0, 0.05),
            surface(Surface::Sphere(axes), 500.0, 0.05),
            surface(Surface::Ground(40.0), 9.0, 12.0),
        ]
    }

    proptest! {
        /// A point of the surface, seen from anywhere near, is found again along the ray to it.
        #[test]
        fn rays_meet_the_point_that_they_aim_at(
            place in [150.0..650.0f64, 100.0..500.0],
            relief in 0.0..1.0f64,
            position in [-4.0..4.0f64, -4.0..4.0, -4.0..4.0],
            form in 0..3usize,
        ) {
            let surface = &forms()[form];
            let (point, inverse) = surface.point(place, relief);
            let ray = core::array::from_fn(|i| point[i] - inverse * position[i]);
            let found = surface.place(ray, position, relief).unwrap();
            for i in 0..2 {
                prop_assert!((found[i] - place[i]).abs() < 1e-6, "{form} {found:?} {place:?}");
            }
        }
    }
}
