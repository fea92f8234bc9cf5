//! Inner loops compiled once more for the wide vectors of newer processors, with the same bits on each.

/// Work for wide vectors: element by element, with no sum across elements. `run` and all it calls in its
/// loops must be marked `#[inline(always)]`; otherwise it runs narrow, with the same result.
pub trait Kernel {
    /// True for loops with so many sums that they need the registers of AVX-512.
    const MANY_SUMS: bool = false;

    /// Does the work.
    fn run(self);
}

/// Runs `kernel` compiled for the widest vectors this processor has; the results do not depend on it,
/// since the compiler never fuses or reorders floating-point operations.
pub fn vectorised<K: Kernel>(kernel: K) {
    #[cfg(target_arch = "x86_64")]
    {
        if K::MANY_SUMS && std::arch::is_x86_feature_detected!("avx512f") {
            // SAFETY: the processor has AVX-512, as the line above has asked.
            return unsafe { with_avx512(kernel) };
        }
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2, as the line above has asked.
            return unsafe { with_avx2(kernel) };
        }
    }
    kernel.run();
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn with_avx2(kernel: impl Kernel) {
    kernel.run();
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
fn with_avx512(kernel: impl Kernel) {
    kernel.run();
}

/// Ways to run a kernel, one for each width that this processor has.
#[cfg(test)]
pub fn widths<K: Kernel>() -> Vec<fn(K)> {
    let mut all: Vec<fn(K)> = vec![K::run];
    #[cfg(target_arch = "x86_64")]
    {
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2, as the line above has asked.
            all.push(|kernel| unsafe { with_avx2(kernel) });
        }
        if std::arch::is_x86_feature_detected!("avx512f") {
            // SAFETY: the processor has AVX-512, as the line above has asked.
            all.push(|kernel| unsafe { with_avx512(kernel) });
        }
    }
    all
}
