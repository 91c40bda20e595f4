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
