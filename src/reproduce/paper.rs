//! What the paper printed, to stand beside what is measured here.

/// One row of Table 1: `mse` x 10^3 and LPIPS of perspective pictures.
#[derive(Clone, Copy, Debug)]
pub struct Printed {
    /// Our material that stands in for the paper's.
    pub material: &'static str,
    /// `mse` x 10^3 of the paper's method and of NeuMIP.
    pub mse: [f64; 2],
    /// LPIPS of the paper's method and of NeuMIP.
    pub lpips: [f64; 2],
}

/// Table 1. Leather07 and Leather11 are measured materials; our `leather` stands beside the first.
pub const TABLE_1: [Printed; 7] = [
    Printed { material: "basket-cloth", mse: [0.395, 28.071], lpips: [0.104, 0.341] },
    Printed { material: "turtle-shell", mse: [0.0561, 0.703], lpips: [0.070, 0.163] },
    Printed { material: "victorian-fabric", mse: [1.335, 8.071], lpips: [0.104, 0.141] },
    Printed { material: "rocks", mse: [0.096, 0.384], lpips: [0.0673, 0.127] },
    Printed { material: "metal-rings", mse: [0.342, 3.474], lpips: [0.139, 0.215] },
    Printed { material: "insulation-foam", mse: [4.133, 41.436], lpips: [0.049, 0.243] },
    Printed { material: "leather", mse: [0.054, 1.690], lpips: [0.0325, 0.342] },
];

/// The paper's row of a material, where it has one.
pub fn printed(material: &str) -> Option<Printed> {
    TABLE_1.into_iter().find(|row| row.material == material)
}
