//! Inner loops compiled once more for the wide vectors of newer processors, with the same bits on each.

/// Work for wide vectors: element by element, with no sum across elements. `run` and all it calls in its
/// loops must be marked `#[inline(always)]`; otherwise it runs narrow, with the same result.
pub trait Kernel {
    /// Does the work.
    fn run(self);
}

/// Runs `kernel` compiled for the widest vectors this processor has; the results do not depend on it,
/// since the compiler never fuses or reorders floating-point operations.
pub fn vectorised(kernel: impl Kernel) {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn with_avx2(kernel: impl Kernel) {
            kernel.run();
        }
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2, as the line above has asked.
            return unsafe { with_avx2(kernel) };
        }
    }
    kernel.run();
}
