use super::*;

#[test]
fn the_processor_is_always_there() {
    let open = OpenDevice::open(ComputeDevice::Cpu).unwrap();
    assert_eq!(open.choice, ComputeDevice::Cpu);
    assert!(crate::ops::has_kernels(&open.device), "{open}");
    assert!(crate::ops::has_kernels(&open.device.autodiff()));
}

#[test]
fn auto_finds_something_and_never_a_software_driver() {
    let open = OpenDevice::open(ComputeDevice::Auto).unwrap();
    assert_ne!(open.choice, ComputeDevice::Auto);
    assert!(!open.name.contains("llvmpipe"), "{open}");
}

/// No machine has so many, and a binary without the feature says which one it lacks.
#[test]
fn a_device_that_is_not_there_is_an_error_with_the_remedy() {
    for (text, feature, compiled) in [("vulkan:999", "vulkan", COMPILED_VULKAN), ("cuda:999", "cuda", COMPILED_CUDA)] {
        let message = OpenDevice::open(text.parse().unwrap()).unwrap_err().to_string();
        let wanted = if compiled { "`cpu`".to_owned() } else { format!("--features {feature}") };
        let counted = compiled && message.contains("counted from 0");
        assert!(message.contains(text) && (message.contains(&wanted) || counted), "{message}");
    }
}
