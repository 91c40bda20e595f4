use super::*;
use proptest::prelude::*;

fn any_device() -> impl Strategy<Value = ComputeDevice> {
    let number = || proptest::option::of(any::<u16>());
    prop_oneof![
        Just(ComputeDevice::Auto),
        Just(ComputeDevice::Cpu),
        number().prop_map(ComputeDevice::Vulkan),
        number().prop_map(ComputeDevice::Cuda),
    ]
}

proptest! {
    #[test]
    fn what_is_written_is_read_again(device in any_device()) {
        prop_assert_eq!(device.to_string().parse::<ComputeDevice>().unwrap(), device);
        let json = serde_json::to_string(&device).unwrap();
        prop_assert_eq!(serde_json::from_str::<ComputeDevice>(&json).unwrap(), device);
    }
}

#[test]
fn other_words_are_refused_with_the_list() {
    for text in ["", "gpu", "cpu:0", "auto:1", "vulkan:", "vulkan:-1", "cuda:x", "cuda:1:2", "CUDA"] {
        let message = text.parse::<ComputeDevice>().unwrap_err().to_string();
        assert!(message.contains("vulkan:N") && message.contains(&format!("`{text}`")), "{message}");
    }
}

#[test]
fn the_processor_is_always_there() {
    let open = ComputeDevice::Cpu.open().unwrap();
    assert_eq!(open.choice, ComputeDevice::Cpu);
    assert!(crate::ops::has_kernels(&open.device), "{open}");
    assert!(crate::ops::has_kernels(&open.device.autodiff()));
}

#[test]
fn auto_finds_something_and_never_a_software_driver() {
    let open = ComputeDevice::Auto.open().unwrap();
    assert_ne!(open.choice, ComputeDevice::Auto);
    assert!(!open.name.contains("llvmpipe"), "{open}");
}

/// No machine has so many, and a binary without the feature says which one it lacks.
#[test]
fn a_device_that_is_not_there_is_an_error_with_the_remedy() {
    for (text, feature, compiled) in [("vulkan:999", "vulkan", COMPILED_VULKAN), ("cuda:999", "cuda", COMPILED_CUDA)] {
        let message = text.parse::<ComputeDevice>().unwrap().open().unwrap_err().to_string();
        let wanted = if compiled { "`cpu`".to_owned() } else { format!("--features {feature}") };
        let counted = compiled && message.contains("counted from 0");
        assert!(message.contains(text) && (message.contains(&wanted) || counted), "{message}");
    }
}
