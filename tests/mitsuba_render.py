"""Renders the scene of a file with Mitsuba 3, for tests/mitsuba.rs, which writes that file.

    python mitsuba_render.py SCENE.json RESULT.json

A scene is a tile (triangle meshes and fibres) and its views: pairs of directions to the light (wi) and to the viewer (wo).
The result is, for each view, the mean over independent renders of every pixel, and the variance of that mean.
"""

import json
import math
import os
import sys

import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")

# Scenes are rendered this much larger, around the origin. Mitsuba starts secondary rays 9e-5 (1 + |p|) off the surface: in
# tile widths that is 2e-4 around a tile of size 1, and 5e-5 around one of size 64.
SIZE = 64.0
# Alpha below this is raised to it, as the material's definition says.
MIN_ALPHA = 0.002


def fresnel(f0, bend):
    """Schlick, with bend = (1 - cos)^5 and F90 = min(1, 50 F0)."""
    return f0 + (min(1.0, 50.0 * f0) - f0) * bend


def schlick(cosine):
    return max(0.0, 1.0 - cosine) ** 5


class Layered(mi.BSDF):
    """A diffuse base under GGX with height-correlated Smith masking, blended with a GGX metal.

    f = (1 - m) [base / pi (1 - F(cos_i)) (1 - F(cos_o)) + D V F(cos_d)] + m D V F(cos_d; base)
    """

    def __init__(self, properties):
        super().__init__(properties)
        self.base = properties["base"]
        self.roughness = properties["roughness"]
        self.metalness = properties["metalness"]
        self.specular = properties["specular"]
        flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
        self.m_components = [flags]
        self.m_flags = flags

    def look(self, si):
        roughness = self.roughness.eval_1(si)
        facets = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, max(roughness * roughness, MIN_ALPHA))
        return self.base.eval(si), facets, self.metalness.eval_1(si), self.specular.eval_1(si)

    @staticmethod
    def gloss(look, cosine):
        """Share of the samples that are drawn from the facets: where most of the light goes."""
        base, _, metalness, specular = look
        bend = schlick(cosine)
        mean = (base.x + base.y + base.z) / 3.0
        layer = fresnel(specular, bend)
        lobe = (1.0 - metalness) * layer + metalness * fresnel(mean, bend)
        diffuse = (1.0 - metalness) * mean
        return min(0.95, lobe / (lobe + diffuse)) if lobe > 0.0 else 0.0

    def value_and_pdf(self, look, si, wo):
        """f cos and the density of `draw`."""
        base, facets, metalness, specular = look
        wi = si.wi
        if wi.z <= 0.0 or wo.z <= 0.0:
            return mi.Color3f(0.0), 0.0
        half = wi + wo
        half /= math.sqrt(half.x * half.x + half.y * half.y + half.z * half.z)
        cos_d = wi.x * half.x + wi.y * half.y + wi.z * half.z
        bend = schlick(cos_d)
        # Smith's Lambda = 1 / G1 - 1; correlated by height G2 = 1 / (1 + Lambda_i + Lambda_o).
        masking = 1.0 / (1.0 / facets.smith_g1(wi, half) + 1.0 / facets.smith_g1(wo, half) - 1.0)
        lobe = facets.eval(half) * masking / (4.0 * wi.z * wo.z)
        dielectric = (1.0 - metalness) * lobe * fresnel(specular, bend)
        through = (1.0 - fresnel(specular, schlick(wi.z))) * (1.0 - fresnel(specular, schlick(wo.z)))
        diffuse = (1.0 - metalness) * through / math.pi

        def channel(b):
            return wo.z * (b * diffuse + dielectric + metalness * lobe * fresnel(b, bend))

        gloss = self.gloss(look, wi.z)
        pdf = (1.0 - gloss) * wo.z / math.pi
        if gloss > 0.0:
            pdf += gloss * facets.pdf(wi, half) / (4.0 * cos_d)
        return mi.Color3f(channel(base.x), channel(base.y), channel(base.z)), pdf

    def eval(self, ctx, si, wo, active):
        return self.value_and_pdf(self.look(si), si, wo)[0]

    def pdf(self, ctx, si, wo, active):
        return self.value_and_pdf(self.look(si), si, wo)[1]

    def eval_pdf(self, ctx, si, wo, active):
        return self.value_and_pdf(self.look(si), si, wo)

    def sample(self, ctx, si, sample1, sample2, active):
        sample = mi.BSDFSample3f()
        wi = si.wi
        if wi.z <= 0.0:
            return sample, mi.Color3f(0.0)
        look = self.look(si)
        if sample1 < self.gloss(look, wi.z):
            half, _ = look[1].sample(wi, sample2)
            wo = half * (2.0 * (wi.x * half.x + wi.y * half.y + wi.z * half.z)) - wi
        else:
            wo = mi.warp.square_to_cosine_hemisphere(sample2)
        value, pdf = self.value_and_pdf(look, si, wo)
        if pdf <= 0.0:
            return sample, mi.Color3f(0.0)
        sample.wo = wo
        sample.pdf = pdf
        sample.eta = 1.0
        sample.sampled_type = +mi.BSDFFlags.GlossyReflection
        sample.sampled_component = 0
        return sample, value / pdf

    def to_string(self):
        return "Layered[]"


mi.register_bsdf("layered", Layered)


def texture(channels, values):
    """`side * side` texels, row by row; texel centres at (j + 1/2) / side."""
    texels = np.array(values, np.float32)
    side = math.isqrt(len(texels) // channels)
    return {
        "type": "bitmap",
        "bitmap": mi.Bitmap(texels.reshape(side, side, channels)),
        "raw": True,
        "filter_type": "bilinear",
        "wrap_mode": "repeat",
    }


def surface(paint):
    """Mitsuba's own Lambert where there is no gloss, which makes it a check of `Layered` in our scene as well."""
    if not any(paint["specular"]) and not any(paint["metalness"]):
        return {"type": "diffuse", "reflectance": texture(3, paint["base_colour"])}
    return {
        "type": "layered",
        "base": texture(3, paint["base_colour"]),
        "roughness": texture(1, paint["roughness"]),
        "metalness": texture(1, paint["metalness"]),
        "specular": texture(1, paint["specular"]),
    }


def place(points, shift=(0, 0)):
    return ((points + [shift[0] - 0.5, shift[1] - 0.5, 0.0]) * SIZE).astype(np.float32)


def copies(repeat):
    return [(i, j) for i in range(-repeat, repeat + 1) for j in range(-repeat, repeat + 1)]


def mesh(part, repeat):
    """The tile's triangles and their copies as one mesh without normals of its own: it is shaded by the faces'."""
    points = np.array(part["positions"]).reshape(-1, 3)
    faces = np.array(part["triangles"], np.uint32).reshape(-1, 3)
    shifts = copies(repeat)
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(surface(part["paint"]))
    shape = mi.Mesh(
        "tiles",
        vertex_count=len(points) * len(shifts),
        face_count=len(faces) * len(shifts),
        props=properties,
        has_vertex_normals=False,
        has_vertex_texcoords=True,
    )
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = np.concatenate([place(points, s) for s in shifts]).ravel()
    parameters["vertex_texcoords"] = np.tile(points[:, :2].astype(np.float32), (len(shifts), 1)).ravel()
    parameters["faces"] = np.concatenate(
        [faces + np.uint32(k * len(points)) for k in range(len(shifts))]
    ).ravel()
    parameters.update()
    return shape


def fibres(part, repeat, folder):
    """Uniform cubic B-splines. A spline that repeats goes on by whole tiles, `period`, beyond its control points."""
    look = part["look"]
    most = max(max(look["absorption"]), 1e-6)
    bsdf = {
        "type": "hair",
        "longitudinal_roughness": look["longitudinal_roughness"],
        "azimuthal_roughness": look["azimuthal_roughness"],
        "scale_tilt": look["tilt"],
        "int_ior": look["ior"],
        "ext_ior": 1.0,
        "sigma_a": {"type": "rgb", "value": [a / most for a in look["absorption"]]},
        "scale": most,
    }
    path = os.path.join(folder, "curves.txt")
    with open(path, "w") as file:
        for spline in part["splines"]:
            points = np.array(spline["points"])
            period = np.array(spline["period"] + [0.0])
            ways = range(-repeat, repeat + 1)
            # Along itself the spline is one long curve, with the control points that its ends lack; across it is copied.
            along = np.concatenate([points + k * period for k in ways] + [points[:3] + (repeat + 1) * period])
            across = np.array([period[1], period[0]])
            for k in ways:
                for x, y, z in place(along, k * across):
                    file.write(f"{x:.9g} {y:.9g} {z:.9g} {part['radius'] * SIZE:.9g}\n")
                file.write("\n")
    return {"type": "bsplinecurve", "filename": path, "bsdf": bsdf}


def sensor(wo, side, low_to_high):
    """Rays along -wo, one film over the tile on the plane z = 0: the camera is sheared, its film parallel to the plane."""
    matrix = np.eye(4)
    # Mitsuba's film runs against the camera's x and y.
    matrix[:3, 0] = [-0.5 * SIZE, 0.0, 0.0]
    matrix[:3, 1] = [0.0, -0.5 * SIZE, 0.0]
    matrix[:3, 2] = -wo
    # Above the highest point, with the near plane between.
    height = SIZE * (low_to_high[1] + 0.05)
    matrix[:3, 3] = wo * (height / wo[2])
    return {
        "type": "orthographic",
        "to_world": mi.ScalarTransform4f(matrix),
        "near_clip": 1e-3 * SIZE,
        "far_clip": 1e3 * SIZE,
        "film": {
            "type": "hdrfilm",
            "width": side,
            "height": side,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
            "component_format": "float32",
        },
        "sampler": {"type": "multijitter"},
    }


def unit(w):
    return np.array([w[0], w[1], math.sqrt(1.0 - w[0] ** 2 - w[1] ** 2)])


def light(wi):
    return {
        "type": "directional",
        "direction": (-unit(wi)).tolist(),
        "irradiance": {"type": "rgb", "value": [1.0, 1.0, 1.0]},
    }


def render(scene, folder):
    parts = []
    for part in scene["parts"]:
        parts.append(mesh(part, scene["repeat"]) if part["kind"] == "mesh" else fibres(part, scene["repeat"], folder))
    world = mi.load_dict(
        {
            "type": "scene",
            "light": light(scene["views"][0]["wi"]),
            **{f"part{k}": part for k, part in enumerate(parts)},
        }
    )
    parameters = mi.traverse(world)
    for view in scene["views"]:
        # The geometry stays: its tree is built once.
        parameters["light.to_world"] = mi.traverse(mi.load_dict(light(view["wi"])))["to_world"]
        parameters.update()
        eye = mi.load_dict(sensor(unit(view["wo"]), scene["side"], scene["height_range"]))
        # A depth of 1 is light seen directly, and none is here; Russian roulette would only add noise.
        depth = view["bounces"] + 2
        integrator = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": depth + 1})
        renders = [
            np.array(mi.render(world, sensor=eye, integrator=integrator, spp=scene["spp"], seed=seed), np.float64)
            for seed in range(1, scene["renders"] + 1)
        ]
        variance = np.var(renders, axis=0, ddof=1).mean(axis=2) / len(renders)
        yield {"rgb": np.mean(renders, axis=0).reshape(-1, 3).tolist(), "variance": variance.ravel().tolist()}


def main():
    scene_path, result_path = sys.argv[1:]
    with open(scene_path) as file:
        scene = json.load(file)
    images = list(render(scene, os.path.dirname(scene_path)))
    with open(result_path, "w") as file:
        json.dump({"version": mi.__version__, "images": images}, file)


if __name__ == "__main__":
    main()
