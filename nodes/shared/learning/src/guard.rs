//! A GPU that fails makes an error, not a dead process.
//!
//! burn and CubeCL report a lost device, a failed kernel or exhausted memory as a panic, or at the next read. State is
//! kept on the host, so whatever the device held can be computed again, here or on another one.

use burn::tensor::Device;
use pseudoflow_network::{NetworkError, Result};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Runs work of a GPU; a panic in it becomes [`NetworkError::DeviceFailed`].
pub(crate) fn guarded<T>(device: &str, work: impl FnOnce() -> Result<T>) -> Result<T> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let said = panic.downcast_ref::<String>().cloned();
        let said = said.or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).to_owned()));
        let cause = said.unwrap_or_else(|| "no reason given".into());
        Err(NetworkError::DeviceFailed { device: device.into(), cause })
    })
}

/// [`guarded`] on a GPU. On the processor a panic is a mistake of this program and stays one.
pub(crate) fn guarded_on<T>(device: &Device, work: impl FnOnce() -> Result<T>) -> Result<T> {
    if crate::ops::has_kernels(device) { work() } else { guarded(&format!("{device:?}"), work) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_on_a_gpu_is_an_error_with_its_words() {
        let lost: Result<()> = guarded("vulkan:0", || panic!("device lost ({})", 7));
        let text = lost.unwrap_err().to_string();
        assert!(text.contains("vulkan:0") && text.contains("device lost (7)"), "{text}");
        assert_eq!(guarded("vulkan:0", || Ok(3)).unwrap(), 3);
        let own = guarded::<()>("vulkan:0", || Err(NetworkError::Batch("empty".into()))).unwrap_err();
        assert!(matches!(own, NetworkError::Batch(_)), "errors of the work stay what they are: {own}");
    }
}
