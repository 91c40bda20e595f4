//! How a training run deals with the operating system's memory.

/// Lets this process keep what it frees, up to the largest it ever needed. Every step frees all that it allocated; without
/// this, glibc returns the memory and each page is fetched and cleared again in the next step, 4 to 9 % of its time. Other
/// systems' allocators are left as they are.
pub(crate) fn keep_freed() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: mallopt takes two integers, locks the allocator's state itself and may be called at any time.
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, 1 << 30);
        libc::mallopt(libc::M_TRIM_THRESHOLD, i32::MAX);
    }
}
