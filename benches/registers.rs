//! What the driver says of each shader variant: registers, code size, workgroup memory.
//!
//! `cargo bench --bench registers [-- SCENE …]` draws one frame of each scene (as `encode` names inputs) with every kernel,
//! general and specialized, then has the Vulkan driver compile those shaders once more, as wgpu does, and prints the
//! statistics that `VK_KHR_pipeline_executable_properties` tells. wgpu does not pass them on, so they are asked for here.

use ash::vk;
use planecast::gpu::Shader;
use planecast::measure::flythrough::poses;
use planecast::{Features, GpuOptions, GpuRenderer, Kernel, Options, Outputs, Repeat, Resident};
use planecast_encoder::{BuildOptions, build, source};
use std::error::Error;
use std::ffi::CStr;
use std::sync::Arc;
use wgpu::naga;

const SCENES: [&str; 3] = ["procedural:hills?size=256", "procedural:rocks?size=256", "procedural:mixing?size=256"];

/// A shader as the Vulkan driver gets it.
fn spirv(shader: &Shader) -> Result<(Vec<u32>, naga::Module), Box<dyn Error>> {
    use naga::back::spv;
    use naga::valid::{Capabilities, ValidationFlags, Validator};
    let module = naga::front::wgsl::parse_str(&shader.source)?;
    let info = Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(&module)?;
    let constants = shader.constants.iter().map(|(name, value)| (name.to_string(), *value)).collect();
    let entry = (naga::ShaderStage::Compute, "main");
    let (module, info) = naga::back::pipeline_constants::process_overrides(&module, &info, Some(entry), &constants)?;
    let unchecked = naga::proc::BoundsCheckPolicy::Unchecked;
    let options = spv::Options {
        lang_version: (1, 6),
        flags: spv::WriterFlags::empty(),
        bounds_check_policies: naga::proc::BoundsCheckPolicies {
            index: unchecked,
            buffer: unchecked,
            image_load: unchecked,
            binding_array: unchecked,
        },
        zero_initialize_workgroup_memory: spv::ZeroInitializeWorkgroupMemoryMode::None,
        force_loop_bounding: false,
        emit_int_div_checks: false,
        ..spv::Options::default()
    };
    let stage = spv::PipelineOptions { shader_stage: naga::ShaderStage::Compute, entry_point: "main".into() };
    let words = spv::write_vec(&module, &info, &options, Some(&stage))?;
    Ok((words, module.into_owned()))
}

/// A Vulkan device of its own, and what is needed to ask for statistics.
struct Driver {
    _entry: ash::Entry,
    device: ash::Device,
    statistics: ash::khr::pipeline_executable_properties::Device,
    name: String,
}

impl Driver {
    fn open(name: &str) -> Result<Driver, Box<dyn Error>> {
        // SAFETY: the handles are used as the specification says, on one thread, and live as long as the process.
        unsafe {
            let entry = ash::Entry::load()?;
            let application = vk::ApplicationInfo::default().api_version(vk::API_VERSION_1_3);
            let instance =
                entry.create_instance(&vk::InstanceCreateInfo::default().application_info(&application), None)?;
            let mut all = instance.enumerate_physical_devices()?.into_iter();
            let named = |d: &vk::PhysicalDevice| {
                let properties = instance.get_physical_device_properties(*d);
                properties.device_name_as_c_str().is_ok_and(|n| n.to_string_lossy() == name)
            };
            let physical = all.find(named).ok_or_else(|| format!("no Vulkan device {name}"))?;
            let extension = ash::khr::pipeline_executable_properties::NAME;
            let there = instance.enumerate_device_extension_properties(physical)?;
            if !there.iter().any(|e| e.extension_name_as_c_str() == Ok(extension)) {
                return Err(format!("{name}: its driver does not tell what shaders take").into());
            }
            let queues = [vk::DeviceQueueCreateInfo::default().queue_priorities(&[1.0])];
            let extensions = [extension.as_ptr()];
            let mut executable =
                vk::PhysicalDevicePipelineExecutablePropertiesFeaturesKHR::default().pipeline_executable_info(true);
            let mut features13 = vk::PhysicalDeviceVulkan13Features::default().maintenance4(true);
            let mut features12 = vk::PhysicalDeviceVulkan12Features::default().vulkan_memory_model(true);
            let info = vk::DeviceCreateInfo::default()
                .queue_create_infos(&queues)
                .enabled_extension_names(&extensions)
                .push_next(&mut executable)
                .push_next(&mut features13)
                .push_next(&mut features12);
            let device = instance.create_device(physical, &info, None)?;
            let statistics = ash::khr::pipeline_executable_properties::Device::new(&instance, &device);
            Ok(Driver { _entry: entry, device, statistics, name: name.into() })
        }
    }

    /// Names and values of what is known of a shader.
    fn ask(&self, words: &[u32], module: &naga::Module) -> Result<Vec<(String, u64)>, Box<dyn Error>> {
        let used = module.global_variables.iter().filter_map(|(_, v)| Some((v.binding.as_ref()?.binding, v.space)));
        let bindings: Vec<_> = used
            .map(|(binding, space)| {
                let kind = match space {
                    naga::AddressSpace::Uniform => vk::DescriptorType::UNIFORM_BUFFER,
                    _ => vk::DescriptorType::STORAGE_BUFFER,
                };
                vk::DescriptorSetLayoutBinding::default()
                    .binding(binding)
                    .descriptor_type(kind)
                    .descriptor_count(1)
                    .stage_flags(vk::ShaderStageFlags::COMPUTE)
            })
            .collect();
        // SAFETY: as above; the words are naga's, which are valid.
        unsafe {
            let device = &self.device;
            let set = device.create_descriptor_set_layout(
                &vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings),
                None,
            )?;
            let layout =
                device.create_pipeline_layout(&vk::PipelineLayoutCreateInfo::default().set_layouts(&[set]), None)?;
            let shader = device.create_shader_module(&vk::ShaderModuleCreateInfo::default().code(words), None)?;
            let stage = vk::PipelineShaderStageCreateInfo::default()
                .stage(vk::ShaderStageFlags::COMPUTE)
                .module(shader)
                .name(c"main");
            let info = vk::ComputePipelineCreateInfo::default()
                .flags(vk::PipelineCreateFlags::CAPTURE_STATISTICS_KHR)
                .stage(stage)
                .layout(layout);
            let pipeline =
                device.create_compute_pipelines(vk::PipelineCache::null(), &[info], None).map_err(|(_, e)| e)?[0];
            let of = vk::PipelineInfoKHR::default().pipeline(pipeline);
            let mut known = Vec::new();
            for i in 0..self.statistics.get_pipeline_executable_properties(&of)?.len() {
                let of = vk::PipelineExecutableInfoKHR::default().pipeline(pipeline).executable_index(i as u32);
                for s in self.statistics.get_pipeline_executable_statistics(&of)? {
                    let name = CStr::from_ptr(s.name.as_ptr()).to_string_lossy().into_owned();
                    let value = match s.format {
                        vk::PipelineExecutableStatisticFormatKHR::UINT64 => s.value.u64,
                        vk::PipelineExecutableStatisticFormatKHR::INT64 => s.value.i64.max(0) as u64,
                        _ => continue,
                    };
                    known.push((name, value));
                }
            }
            device.destroy_pipeline(pipeline, None);
            device.destroy_shader_module(shader, None);
            device.destroy_pipeline_layout(layout, None);
            device.destroy_descriptor_set_layout(set, None);
            Ok(known)
        }
    }
}

fn run(scenes: &[String]) -> Result<(), Box<dyn Error>> {
    let mut driver: Option<Driver> = None;
    for name in scenes {
        let input = source::open(name.as_ref(), &source::ReadOptions::default())?;
        let scene = Arc::new(build(input, &BuildOptions::default())?);
        let views = [
            (
                "repeated",
                Options { repeat: Repeat { x: true, z: true }, view_distance: 40_000.0, ..Options::default() },
            ),
            ("single, level 0", Options { lod: None, ..Options::default() }),
        ];
        let mut seen: Vec<Shader> = Vec::new();
        for (view, options) in views {
            for specialize in [Features::NONE, Features::ALL] {
                let options = Options { specialize, ..options };
                let resident = Arc::new(Resident::with(&scene, specialize));
                // Level, as most frames are.
                let camera = poses(&resident, 10, 1024, 768)[0];
                for kernel in Kernel::ALL {
                    let mut gpu = GpuRenderer::new(&scene, &resident, GpuOptions { kernel, ..GpuOptions::default() })?;
                    let stats = gpu.render(&camera, &options, Outputs::default())?.stats;
                    if driver.is_none() {
                        driver = Some(Driver::open(&stats.device)?);
                    }
                    let left_out = stats.left_out;
                    let driver = driver.as_ref().expect("opened above");
                    for shader in gpu.shaders() {
                        if seen.contains(&shader) {
                            continue;
                        }
                        let (words, module) = spirv(&shader)?;
                        let known = driver.ask(&words, &module)?;
                        let known: Vec<_> = known.iter().map(|(name, n)| format!("{name} {n}")).collect();
                        println!(
                            "{name}, {view}, without {}: {} {}: SPIR-V {} B, {}",
                            if left_out.is_empty() { "nothing".into() } else { left_out.join("+") },
                            shader.name,
                            shader.defines.join("+"),
                            4 * words.len(),
                            known.join(", ")
                        );
                        seen.push(shader);
                    }
                }
            }
        }
    }
    if let Some(driver) = driver {
        println!("on {}", driver.name);
    }
    Ok(())
}

fn main() {
    let mut scenes: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    if scenes.is_empty() {
        scenes = SCENES.map(String::from).into();
    }
    if let Err(e) = run(&scenes) {
        println!("{e}");
    }
}
