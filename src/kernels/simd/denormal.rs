//! Threads whose denormals are flushed to zero, as hosts of renderers set them.

/// Does `work` on this thread with denormal inputs and results taken as 0, and sets the thread back; none where no such mode is
/// known. What other threads do for `work` is not flushed.
///
/// Compilers take the thread's mode to be the usual one, and may have computed constants in it: an answer is that of one mode
/// or the other. Use it to compare the two, for nothing else.
#[cfg(target_arch = "x86_64")]
pub fn flushing<T>(work: impl FnOnce() -> T) -> Option<T> {
    use std::arch::asm;

    /// Flush results (bit 15) and inputs (bit 6).
    const MODES: u32 = 1 << 15 | 1 << 6;

    fn read() -> u32 {
        let mut control = 0u32;
        // SAFETY: every x86-64 has the instruction; it writes the four bytes of a local.
        unsafe { asm!("stmxcsr [{}]", in(reg) &raw mut control, options(nostack)) }
        control
    }

    fn write(control: u32) {
        // SAFETY: as above; the value is the thread's own but for two bits that raise no exceptions.
        unsafe { asm!("ldmxcsr [{}]", in(reg) &raw const control, options(nostack, readonly)) }
    }

    /// Sets the thread back, also where the work panics.
    struct Restore(u32);

    impl Drop for Restore {
        fn drop(&mut self) {
            write(self.0);
        }
    }

    let restore = Restore(read());
    write(restore.0 | MODES);
    Some(work())
}

/// None: no such mode is known on this machine.
#[cfg(not(target_arch = "x86_64"))]
pub fn flushing<T>(_: impl FnOnce() -> T) -> Option<T> {
    None
}

#[cfg(test)]
mod tests {
    use super::flushing;
    use std::hint::black_box;

    #[test]
    fn denormals_are_0_inside_and_nowhere_else() {
        let halved = || black_box(f32::MIN_POSITIVE) * black_box(0.5);
        assert!(halved() > 0.0);
        if let Some(inside) = flushing(|| halved() == 0.0) {
            assert!(inside);
        }
        assert!(halved() > 0.0);
        let panicked = std::panic::catch_unwind(|| flushing(|| panic!("inside")));
        assert!(panicked.is_err() || cfg!(not(target_arch = "x86_64")));
        assert!(halved() > 0.0);
    }
}
