//! Bad geometry, odd rays.

use super::*;

#[test]
fn pieces_without_size_are_left_out() {
    let mut data = some_curves();
    let rays = some_rays(500, |_| true);
    let clean = Curves::new(&data).unwrap();
    let twice = data[3].points[2];
    data[3].points.insert(2, twice);
    data.push(Curve { points: vec![[0.5; 3]; 5], radius: 0.1, look: 0 });
    let doubled = Curves::new(&data).unwrap();
    let mut mesh = some_triangles();
    let whole = Triangles::new(mesh.clone()).unwrap();
    mesh.positions.extend([[0.25, 0.25, 0.0], [0.5, 0.5, 0.0], [0.75, 0.75, 0.0]]);
    mesh.triangles.extend([[5, 5, 9], [120, 121, 122]]);
    let padded = Triangles::new(mesh).unwrap();
    for (o, d) in rays {
        assert_eq!(clean.intersect(o, d, 9.0), doubled.intersect(o, d, 9.0));
        assert_eq!(whole.intersect(o, d, 9.0), padded.intersect(o, d, 9.0));
    }
    assert!(Curves::new(&data[data.len() - 1..]).unwrap_err().to_string().contains("positive size"));
}

#[test]
fn bad_geometry_is_named() {
    let complaint = |curve: Curve| Curves::new(&[some_curves().remove(1), curve]).unwrap_err().to_string();
    let good = some_curves().remove(2);
    let with = |point: [f64; 3]| {
        let mut curve = good.clone();
        curve.points[4] = point;
        complaint(curve)
    };
    for (point, words) in [
        ([f64::NAN, 0.0, 0.0], "not finite"),
        ([0.0, f64::INFINITY, 0.0], "not finite"),
        ([0.0, 65.0, 0.0], "64 tile widths"),
        ([0.0, 0.0, -1.1], "plane"),
    ] {
        let said = with(point);
        assert!(said.starts_with("curves[1].points[4]: ") && said.contains(words), "{said}");
    }
    assert!(with([0.5, 0.5, 0.999]).contains("span"));
    for radius in [0.0, -1.0, 0.3, f64::NAN, f64::INFINITY] {
        assert!(complaint(Curve { radius, ..good.clone() }).starts_with("curves[1].radius"));
    }
    assert!(complaint(Curve { points: vec![[0.0; 3]], ..good.clone() }).contains("at least 2"));
    assert!(Curves::new(&[]).is_err());

    let broken = |change: &dyn Fn(&mut TriangleMesh)| {
        let mut mesh = some_triangles();
        change(&mut mesh);
        Triangles::new(mesh).unwrap_err().to_string()
    };
    assert!(broken(&|m| m.triangles.clear()).contains("none"));
    assert!(broken(&|m| m.triangles[3][1] = 120).starts_with("mesh.triangles[3]: names corner 120"));
    assert!(broken(&|m| m.positions[5][2] = f64::NAN).starts_with("mesh.positions[5]"));
    assert!(broken(&|m| m.positions[5][2] = 2.0).contains("plane"));
    assert!(broken(&|m| m.positions[5][0] = -70.0).contains("64"));
    assert!(broken(&|m| m.normals = Some(vec![[0.0; 3]; 4])).starts_with("mesh.normals"));
    assert!(broken(&|m| m.uv = Some(vec![[f64::NAN; 2]; 120])).starts_with("mesh.uv[0]"));
    assert!(broken(&|m| m.triangles.iter_mut().for_each(|t| t[1] = t[0])).contains("positive size"));
}

#[test]
fn odd_rays_end() {
    let (curves, mesh) = (Curves::new(&fibre(0.1)).unwrap(), Triangles::new(sheet(8, 0.1)).unwrap());
    let (big, nan, inf) = (1e300, f64::NAN, f64::INFINITY);
    let down = [0.0, 0.0, -1.0];
    for (o, d, t) in [
        ([nan, 0.0, 1.0], down, inf),
        ([0.0, 0.0, inf], down, inf),
        ([0.5, 0.5, 1.0], [nan, 0.0, -1.0], inf),
        ([0.5, 0.5, 1.0], [0.0; 3], inf),
        ([0.5, 0.5, 1.0], [inf, 0.0, -1.0], inf),
        ([0.5, 0.5, 1.0], down, nan),
        ([0.5, 0.5, 1.0], down, -1.0),
        ([big, 0.5, 1.0], down, inf),
        ([0.5, 0.5, 1.0], [1.0, 1.0, 1e-300], inf),
    ] {
        assert!(curves.intersect(o, d, t).is_none() && mesh.intersect(o, d, t).is_none(), "{o:?} {d:?}");
    }
    // Level rays beside the fibre run to the end of the world; those above the mesh do not even start.
    assert!(!curves.occluded([0.5, 0.25, 0.0], [1.0, 0.0, 0.0]));
    assert!(!mesh.occluded([0.5, 0.25, 0.06], [1.0, 0.01, 0.0]));
    assert!(curves.occluded([0.5, 0.25, 0.0], [1.0, 1e-4, 0.0]));
}
