use super::*;
use crate::random::{Random, Stream};

const SIDE: u32 = 24;

/// A wavy square with its height as normals' slope, and texture coordinates like the plane's.
fn waves() -> RawMesh {
    let mut raw = RawMesh::default();
    for k in 0..(SIDE + 1) * (SIDE + 1) {
        let [u, v] = [k % (SIDE + 1), k / (SIDE + 1)].map(|i| f64::from(i) / f64::from(SIDE));
        let (x, y) = (2.0 * u - 1.0, 2.0 * v - 1.0);
        raw.positions.push([x, y, 0.2 * (4.0 * x).sin() * (3.0 * y).cos()]);
        raw.uv.push([u, v]);
    }
    for k in 0..SIDE * SIDE {
        let a = k / SIDE * (SIDE + 1) + k % SIDE;
        let [b, c, d] = [a + 1, a + SIDE + 2, a + SIDE + 1];
        raw.triangles.extend([[a, b, c], [a, c, d]]);
    }
    raw
}

fn ray(random: &mut Random) -> Ray {
    let mut point = || DVec3::from_array(std::array::from_fn(|_| 2.0 * random.uniform_f64() - 1.0));
    let (origin, aim) = (point() * 3.0, point());
    Ray { origin, direction: (aim - origin) * 0.7 }
}

#[test]
fn the_tree_finds_what_a_look_at_every_triangle_finds() {
    let (mesh, notes) = Mesh::new(waves(), true).unwrap();
    assert!(notes.is_empty() && mesh.triangles() == 2 * SIDE as usize * SIDE as usize);
    let mut random = Random::new(2, Stream::Probe, 0);
    let mut hits = 0;
    for _ in 0..500 {
        let ray = ray(&mut random);
        let far = 3.0 * random.uniform_f64();
        let all = (0..mesh.triangles() as u32).filter_map(|k| mesh.meet(&ray, k));
        let all = all.filter(|near| near.t > 0.0 && near.t < far).map(|near| near.t);
        let nearest = all.reduce(f64::min);
        assert_eq!(mesh.nearest(&ray, far).map(|near| near.t), nearest);
        assert_eq!(mesh.blocks(&ray, far), nearest.is_some());
        hits += usize::from(nearest.is_some());
    }
    assert!((100..400).contains(&hits), "{hits}");
}

#[test]
fn no_ray_falls_through_the_edges() {
    let (mesh, _) = Mesh::new(waves(), true).unwrap();
    for k in 0..10_000u32 {
        // Along the diagonals and borders of the triangles.
        let [i, j] = [k % 100, k / 100].map(|i| f64::from(i + 1) / 101.0);
        let step = f64::from(k / 100 % SIDE) / f64::from(SIDE);
        for aim in [DVec3::new(2.0 * step.max(0.01) - 1.0, 2.0 * j - 1.0, 0.0), DVec3::new(i, i, 0.0)] {
            let ray = Ray { origin: aim + DVec3::new(0.0, 0.0, 1e3), direction: -DVec3::Z };
            assert!(mesh.nearest(&ray, f64::INFINITY).is_some(), "{aim}");
        }
    }
}

#[test]
fn texture_coordinates_have_their_derivatives() {
    let (mesh, _) = Mesh::new(waves(), true).unwrap();
    let ray = Ray { origin: DVec3::new(0.31, -0.22, 5.0), direction: -DVec3::Z };
    let patch = mesh.patch(&mesh.nearest(&ray, f64::INFINITY).unwrap());
    // u and v are x and y, halved and moved.
    let exact = |k: usize| 0.5 * (ray.origin[k] + 1.0);
    assert!((0..2).all(|k| (patch.uv[k] - exact(k)).abs() < 1e-12));
    assert!((patch.du.truncate() - glam::DVec2::new(2.0, 0.0)).length() < 1e-12);
    assert!((patch.dv.truncate() - glam::DVec2::new(0.0, 2.0)).length() < 1e-12);
    assert!(patch.geometric.z > 0.0 && patch.du.dot(patch.geometric).abs() < 1e-12);
}

#[test]
fn some_degenerate_triangles_are_noted_and_all_of_them_refused() {
    let mut raw = waves();
    raw.triangles.push([0, 0, 1]);
    raw.uv.iter_mut().take(30).for_each(|uv| *uv = [0.5; 2]);
    let (mesh, notes) = Mesh::new(raw.clone(), true).unwrap();
    assert_eq!(mesh.triangles(), 2 * SIDE as usize * SIDE as usize);
    assert!(notes.iter().any(|n| n.contains("no area")) && notes.iter().any(|n| n.contains("degenerate")));
    raw.uv.iter_mut().for_each(|uv| *uv = [0.5; 2]);
    assert!(Mesh::new(raw.clone(), true).unwrap_err().contains("degenerate"));
    raw.uv.clear();
    assert!(Mesh::new(raw.clone(), true).unwrap_err().contains("no texture coordinates"));
    assert!(Mesh::new(raw, false).is_ok());
}
