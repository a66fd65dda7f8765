//! Adapter, device, pipelines and timestamps: everything of wgpu that is not a stage.

use crate::error::{Error, Result};
use crate::gpu::shaders::{self, Variant};
use std::collections::HashMap;
use std::sync::{Arc, Mutex};

/// A device and its compiled pipelines.
pub struct Engine {
    pub device: wgpu::Device,
    pub queue: wgpu::Queue,
    pub limits: wgpu::Limits,
    /// The adapter's name and driver.
    pub name: String,
    pub driver: String,
    /// Whether the adapter is a processor that plays GPU.
    pub software: bool,
    /// Nanoseconds a timestamp tick; `None` where the device has no timestamps.
    pub tick_ns: Option<f32>,
    trusted: bool,
    pipelines: Pipelines,
    failure: Failure,
}

/// An open device.
#[derive(Clone, Debug)]
pub struct Device {
    pub info: wgpu::AdapterInfo,
    pub device: wgpu::Device,
    pub queue: wgpu::Queue,
    pub failure: Failure,
    /// Those of all that draws on it: who goes into another scene does not compile anew.
    pub pipelines: Pipelines,
}

/// Compiled pipelines by what they were made from.
#[derive(Clone, Default)]
pub struct Pipelines(Arc<Mutex<HashMap<String, Arc<Pipeline>>>>);

impl std::fmt::Debug for Pipelines {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} pipelines", lock(&self.0).len())
    }
}

/// The first error that a device reported outside any scope, or why it was lost.
#[derive(Clone, Debug, Default)]
pub struct Failure(Arc<Mutex<Option<String>>>);

impl Device {
    /// Opens an adapter, for pictures that no surface shows.
    pub fn on(adapter: &wgpu::Adapter) -> Result<Device> {
        let info = adapter.get_info();
        let opened = pollster::block_on(adapter.request_device(&Engine::wishes(adapter)));
        let (device, queue) = opened
            .map_err(|e| Error::Device(format!("{}: cannot open the device ({e}): try --device cpu", info.name)))?;
        Ok(Device::watched(info, device, queue))
    }

    /// What happens to it is heard from now on.
    pub fn watched(info: wgpu::AdapterInfo, device: wgpu::Device, queue: wgpu::Queue) -> Device {
        let failure = Failure::watch(&device);
        Device { info, device, queue, failure, pipelines: Pipelines::default() }
    }
}

impl Failure {
    /// Hears what happens to a device from now on; without it wgpu ends the program at an error.
    pub fn watch(device: &wgpu::Device) -> Failure {
        let failure = Failure::default();
        let seen = failure.clone();
        device.on_uncaptured_error(Arc::new(move |e: wgpu::Error| {
            lock(&seen.0).get_or_insert(one_line(&e.to_string()));
        }));
        let seen = failure.clone();
        device.set_device_lost_callback(move |_, text| {
            // Why everything else fails.
            lock(&seen.0).replace(format!("device lost: {}", one_line(&text)));
        });
        failure
    }

    pub fn text(&self) -> Option<String> {
        lock(&self.0).clone()
    }
}

/// A shader that frames were drawn with, as text: for what looks at it otherwise than by drawing.
#[derive(Clone, Debug, PartialEq)]
pub struct Shader {
    /// Of its file, without `.wgsl`.
    pub name: &'static str,
    pub defines: Vec<&'static str>,
    /// Values of its `override` declarations.
    pub constants: Vec<(&'static str, f64)>,
    /// In WGSL; its entry point is `main`.
    pub source: String,
}

/// A compiled shader and the buffers it binds.
pub struct Pipeline {
    name: &'static str,
    variant: Variant,
    constants: Vec<(&'static str, f64)>,
    pub pipeline: wgpu::ComputePipeline,
    pub bindings: Vec<(u32, String)>,
}

impl Engine {
    /// Opens the adapter that the environment names (`WGPU_ADAPTER_NAME`, `WGPU_BACKEND`), else the most powerful.
    pub fn new(trusted: bool) -> Result<Engine> {
        Engine::on(&Engine::choose(&instance(), None)?, trusted)
    }

    /// Opens an adapter.
    pub fn on(adapter: &wgpu::Adapter, trusted: bool) -> Result<Engine> {
        Ok(Engine::with_device(Device::on(adapter)?, trusted))
    }

    /// All adapters of the kind of the most powerful: through the same API, as one device may be there through several, and
    /// software only where that one is.
    pub fn adapters(instance: &wgpu::Instance) -> Result<Vec<wgpu::Adapter>> {
        let best = Engine::choose(instance, None)?.get_info();
        let software = |info: &wgpu::AdapterInfo| info.device_type == wgpu::DeviceType::Cpu;
        let mut adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
        adapters.retain(|a| {
            let info = a.get_info();
            info.backend == best.backend && software(&info) == software(&best)
        });
        Ok(adapters)
    }

    /// The adapter that the environment names, else the most powerful; one that can draw on `surface`.
    pub fn choose(instance: &wgpu::Instance, surface: Option<&wgpu::Surface<'_>>) -> Result<wgpu::Adapter> {
        if let Ok(name) = std::env::var("WGPU_ADAPTER_NAME") {
            return named_adapter(instance, &name);
        }
        let wanted = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            compatible_surface: surface,
            ..wgpu::RequestAdapterOptions::default()
        };
        pollster::block_on(instance.request_adapter(&wanted)).map_err(|e| {
            Error::Device(format!(
                "no usable GPU adapter ({e}): install a Vulkan, Metal or DX12 driver, or try --device cpu"
            ))
        })
    }

    /// What a device is asked for: all that the adapter has, as scenes and pictures are checked against it, not against
    /// the portable defaults.
    pub fn wishes(adapter: &wgpu::Adapter) -> wgpu::DeviceDescriptor<'static> {
        wgpu::DeviceDescriptor {
            label: Some("planecast"),
            required_features: adapter.features()
                & (wgpu::Features::TIMESTAMP_QUERY
                    | wgpu::Features::TIMESTAMP_QUERY_INSIDE_ENCODERS
                    | wgpu::Features::BGRA8UNORM_STORAGE),
            required_limits: adapter.limits(),
            memory_hints: wgpu::MemoryHints::Performance,
            ..wgpu::DeviceDescriptor::default()
        }
    }

    /// On a device that is open already.
    pub fn with_device(device: Device, trusted: bool) -> Engine {
        let Device { info, device, queue, failure, pipelines } = device;
        let (features, limits) = (device.features(), device.limits());
        let tick_ns = features.contains(wgpu::Features::TIMESTAMP_QUERY).then(|| queue.get_timestamp_period());
        let software = info.device_type == wgpu::DeviceType::Cpu;
        let driver = format!("{} {}", info.driver, info.driver_info).trim().to_string();
        Engine { device, queue, limits, name: info.name, driver, software, tick_ns, trusted, pipelines, failure }
    }

    /// An error if the device reported one since it was opened.
    pub fn check(&self) -> Result<()> {
        match self.failure.text() {
            Some(text) => Err(Error::Device(format!("{}: {text}; try --device cpu", self.name))),
            None => Ok(()),
        }
    }

    /// A buffer that can be written and read back whole.
    pub fn buffer(&self, label: &str, size: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: size.next_multiple_of(16),
            usage: usage | wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        })
    }

    /// Runs `make`, which asks for device memory; an error where the device has not got it.
    pub fn checked<T>(&self, what: &str, make: impl FnOnce() -> T) -> Result<T> {
        // A page cannot wait for the answer: what fails there is heard by `Failure`.
        if cfg!(target_arch = "wasm32") {
            self.check()?;
            return Ok(make());
        }
        let invalid = self.device.push_error_scope(wgpu::ErrorFilter::Validation);
        let memory = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let made = make();
        let memory = pollster::block_on(memory.pop());
        let invalid = pollster::block_on(invalid.pop());
        let Some(e) = memory.or(invalid) else { return Ok(made) };
        self.check_lost()?;
        Err(Error::Limit(format!(
            "{what}: {} cannot hold it ({}); try --device cpu",
            self.name,
            one_line(&e.to_string())
        )))
    }

    /// Waits until all that was submitted is done.
    pub fn flush(&self) -> Result<()> {
        self.queue.submit([]);
        self.wait(None)
    }

    /// Waits for one submission, or for the latest.
    pub fn wait(&self, submission: Option<wgpu::SubmissionIndex>) -> Result<()> {
        let done = self.device.poll(wgpu::PollType::Wait { submission_index: submission, timeout: None });
        self.check_lost()?;
        done.map(drop).map_err(|e| Error::Device(format!("{}: {e}; try --device cpu", self.name)))
    }

    /// Like [`Engine::check`], where something has failed: a device that is lost says so when it is polled.
    fn check_lost(&self) -> Result<()> {
        let _ = self.device.poll(wgpu::PollType::Poll);
        self.check()
    }

    /// The pipeline of a shader variant with its constants, compiled at first use.
    pub fn pipeline(
        &mut self,
        name: &'static str,
        variant: &Variant,
        constants: &[(&'static str, f64)],
    ) -> Result<Arc<Pipeline>> {
        let key = format!("{name} {variant:?} {constants:?} {}", self.trusted);
        if let Some(pipeline) = lock(&self.pipelines.0).get(&key) {
            return Ok(pipeline.clone());
        }
        let source = shaders::assemble(name, variant);
        let bindings =
            shaders::bindings(&source).unwrap_or_else(|e| panic!("shader {name} is part of the program\n{e}"));
        let module = self.module(name, source);
        let pipeline = self.checked(&format!("shader {name}"), || {
            self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(name),
                layout: None,
                module: &module,
                entry_point: Some("main"),
                compilation_options: wgpu::PipelineCompilationOptions {
                    constants,
                    // Kernels set what they read.
                    zero_initialize_workgroup_memory: false,
                },
                cache: None,
            })
        })?;
        let pipeline =
            Arc::new(Pipeline { name, variant: variant.clone(), constants: constants.to_vec(), pipeline, bindings });
        lock(&self.pipelines.0).insert(key, pipeline.clone());
        Ok(pipeline)
    }

    /// All shaders that were compiled so far, by name.
    pub fn shaders(&self) -> Vec<Shader> {
        let shader = |p: &Arc<Pipeline>| Shader {
            name: p.name,
            defines: p.variant.defines.clone(),
            constants: p.constants.clone(),
            source: shaders::assemble(p.name, &p.variant),
        };
        let mut all: Vec<Shader> = lock(&self.pipelines.0).values().map(shader).collect();
        all.sort_by(|a, b| (a.name, &a.defines).cmp(&(b.name, &b.defines)));
        all
    }

    /// A shader module; the one place where wgpu's runtime checks may be left out.
    fn module(&self, name: &str, source: String) -> wgpu::ShaderModule {
        let descriptor =
            wgpu::ShaderModuleDescriptor { label: Some(name), source: wgpu::ShaderSource::Wgsl(source.into()) };
        if !self.trusted {
            return self.device.create_shader_module(descriptor);
        }
        // SAFETY: the shaders are this crate's own. Every index they form comes from a `Resident`, whose positions
        // come from validated `Columns`, or from a `Setup`, whose windows lie within the buffers that `GpuRenderer`
        // sizes by it; loops end because each turn moves on along a plane, a column's runs or a fixed count. A test
        // draws the same pictures with the checks on.
        unsafe { self.device.create_shader_module_trusted(descriptor, wgpu::ShaderRuntimeChecks::unchecked()) }
    }
}

/// The drivers of this machine, loaded once: NVIDIA's runs out of something when it has been loaded some thirty times.
#[cfg(not(target_arch = "wasm32"))]
pub fn instance() -> wgpu::Instance {
    static INSTANCE: std::sync::OnceLock<wgpu::Instance> = std::sync::OnceLock::new();
    INSTANCE.get_or_init(new_instance).clone()
}

#[cfg(target_arch = "wasm32")]
pub fn instance() -> wgpu::Instance {
    new_instance()
}

fn new_instance() -> wgpu::Instance {
    wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env())
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(|e| e.into_inner())
}

/// The first adapter whose name holds `name`, whatever the case.
fn named_adapter(instance: &wgpu::Instance, name: &str) -> Result<wgpu::Adapter> {
    let adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
    let names: Vec<String> = adapters.iter().map(|a| a.get_info().name).collect();
    let wanted = name.to_lowercase();
    let found = adapters.into_iter().find(|a| a.get_info().name.to_lowercase().contains(&wanted));
    found.ok_or_else(|| {
        let there = if names.is_empty() { "none".into() } else { names.join(", ") };
        Error::Device(format!(
            "no usable GPU adapter named {name} (WGPU_ADAPTER_NAME); there are: {there}; try --device cpu"
        ))
    })
}

/// wgpu's errors fill a page; their first lines say what matters.
fn one_line(text: &str) -> String {
    text.lines().map(str::trim).filter(|l| !l.is_empty()).take(3).collect::<Vec<_>>().join(": ")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// In a process of its own: it takes all there is. What a software device has is the process's address space.
    #[test]
    #[cfg(unix)]
    fn memory_that_a_device_has_not_got_is_an_error_with_the_figure() {
        if std::env::var_os("PLANECAST_NO_GPU").is_some_and(|v| v == "1") {
            eprintln!("skipped: PLANECAST_NO_GPU=1");
            return;
        }
        let limit = if Engine::new(true).unwrap().software { "ulimit -v 24000000;" } else { "" };
        let name = "gpu::engine::tests::child_takes_all_memory";
        let child = std::process::Command::new("sh")
            .args(["-c", &format!("{limit} exec \"$0\" {name} --exact --ignored --nocapture")])
            .arg(std::env::current_exe().unwrap())
            .output()
            .unwrap();
        let text = String::from_utf8_lossy(&child.stdout).into_owned();
        assert!(child.status.success(), "{text}\n{}", String::from_utf8_lossy(&child.stderr));
        println!("{}", text.lines().find(|l| l.contains("buffers: ")).unwrap_or_else(|| panic!("{text}")));
    }

    #[test]
    #[ignore = "run by memory_that_a_device_has_not_got_is_an_error_with_the_figure"]
    fn child_takes_all_memory() {
        let engine = Engine::new(true).unwrap();
        // The largest buffers that it allows, until there is no memory for one more.
        let size = engine.limits.max_buffer_size.min(1 << 40) & !0xffff;
        let ask = |size: u64| {
            let what = format!("buffer of {} MiB", size >> 20);
            engine.checked(&what, || engine.buffer("large", size, wgpu::BufferUsages::STORAGE))
        };
        let mut held = Vec::new();
        let error = loop {
            match ask(size) {
                Ok(buffer) => held.push(buffer),
                Err(e) => break e,
            }
            assert!(held.len() < 1000, "{} buffers of {size} bytes", held.len());
        };
        println!("after {} buffers: {error}", held.len());
        let text = error.to_string();
        assert!(matches!(error, Error::Limit(_)), "{text}");
        assert!(text.starts_with(&format!("buffer of {} MiB: ", size >> 20)), "{text}");
        assert!(text.contains("try --device cpu") && text.lines().count() == 1, "{text}");
        // The device goes on.
        drop(held);
        engine.flush().unwrap();
        ask(1 << 20).unwrap();
        engine.check().unwrap();
    }
}
