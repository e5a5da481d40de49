//! What starts several programs that share jobs, held against the program: a compose file, and manifests of Kubernetes.

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

use serde_json::Value;

use super::{Serving, image, read, root, settings};

const COMPOSE: &str = "deploy/compose.yaml";
const MANIFESTS: &str = "deploy/kubernetes";
/// Where servers find their keys.
const KEYS: &str = "/etc/densecloud/keys";

type Environment = BTreeMap<String, String>;

fn yaml(path: &str) -> Vec<Value> {
    serde_saphyr::from_multiple(&read(path)).unwrap_or_else(|why| panic!("{path}: {why}"))
}

fn text(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

fn texts(list: &Value) -> Vec<String> {
    list.as_array().into_iter().flatten().map(text).collect()
}

fn pairs(map: &Value) -> Environment {
    map.as_object().into_iter().flatten().map(|(name, value)| (name.clone(), text(value))).collect()
}

/// Has the program check what it is started with, in the image's environment; gives the settings that came of it.
fn check(file: &str, words: &[String], set: &Environment) -> Environment {
    let keys = tempfile::NamedTempFile::new().expect("a file");
    std::fs::write(keys.path(), format!("alice sha256:{}\n", "0".repeat(64))).expect("a file");
    let mut environment = image().environment;
    environment.extend(set.clone());
    let variables: BTreeSet<_> = settings().into_values().map(|setting| setting.variable).collect();
    for (name, value) in environment.iter_mut().filter(|(name, _)| name.starts_with("DENSECLOUD_")) {
        assert!(variables.contains(name), "{file} sets {name}, which is no setting");
        if *value == KEYS {
            *value = keys.path().to_string_lossy().into_owned();
        }
    }
    let mut program = Command::new(env!("CARGO_BIN_EXE_densecloud"));
    program.env_clear().envs(std::env::var_os("ORT_DYLIB_PATH").map(|path| ("ORT_DYLIB_PATH", path)));
    let output = program.envs(&environment).args(words).arg("--print-config").output().expect("it starts");
    assert!(output.status.success(), "{file}: {words:?} {environment:?}: {output:?}");
    let page = String::from_utf8(output.stdout).expect("UTF-8");
    let lines = page.lines().filter_map(|line| line.trim_start_matches('#').split_once(" = "));
    lines.map(|(key, value)| (key.to_owned(), value.trim_matches('"').to_owned())).collect()
}

fn number(text: &str) -> f64 {
    text.parse().unwrap_or_else(|_| panic!("{text} is no number"))
}

/// Seconds from a signal to the end, at most.
fn drain(settings: &Environment) -> f64 {
    number(&settings["drain-lead"]) + number(&settings["drain-timeout"])
}

/// A setting that is a secret comes from outside of the file.
fn has_no_secret(file: &str, environment: &Environment) {
    let secret = |name: &str| ["PASSWORD", "SECRET"].iter().any(|word| name.contains(word));
    for (name, value) in environment.iter().filter(|(name, _)| secret(name)) {
        assert!(value.starts_with("${") && value.contains(":?"), "{file}: {name} is in it");
    }
}

#[test]
fn the_compose_file_starts_what_there_is() {
    let [compose] = &yaml(COMPOSE)[..] else { panic!("one document") };
    let services = compose["services"].as_object().expect("services");
    for (name, role) in [("serve", "serve"), ("worker", "worker")] {
        let (service, words) = (&services[name], texts(&services[name]["command"]));
        let environment = pairs(&service["environment"]);
        assert_eq!(words[0], role);
        let settings = check(COMPOSE, &words, &environment);
        let stop = text(&service["stop_grace_period"]);
        assert!(
            number(stop.trim_end_matches('s')) > drain(&settings),
            "{name} would be killed before its end"
        );
        assert_eq!(settings["jobs-running"] == "0", role == "serve", "jobs are the workers'");
        assert_eq!(settings["temp-dir"], image().folder, "the folder that its user may write to");
        let database = format!(
            "postgres://densecloud@database/{}",
            text(&services["database"]["environment"]["POSTGRES_DB"])
        );
        assert!(settings["database"].starts_with(&database), "{}", settings["database"]);
        let bucket =
            settings["store"].trim_start_matches("s3://").split('/').next().expect("a bucket").to_owned();
        let makes = texts(&services["bucket"]["command"]).join(" ");
        assert!(makes.contains(&format!("s3.bucket.create -name {bucket}'")), "{makes}");
    }
    let port = format!(":{}", image().port);
    assert!(texts(&services["serve"]["ports"]).iter().all(|published| published.ends_with(&port)));
    assert_eq!(services["worker"]["deploy"]["replicas"], 2);
}

#[test]
fn in_the_compose_file_whatever_is_named_is_there() {
    let [compose] = &yaml(COMPOSE)[..] else { panic!("one document") };
    let services = compose["services"].as_object().expect("services");
    for (name, service) in services {
        has_no_secret(COMPOSE, &pairs(&service["environment"]));
        for (other, condition) in service["depends_on"].as_object().into_iter().flatten() {
            let other = services.get(other).unwrap_or_else(|| panic!("{name} waits for {other}"));
            let ends = condition["condition"] == "service_completed_successfully";
            assert!(ends || other["healthcheck"].is_object(), "{name} waits for {other} to be healthy");
        }
        for volume in texts(&service["volumes"]) {
            let volume = volume.split(':').next().unwrap_or_default();
            assert!(compose["volumes"].get(volume).is_some(), "{name} has a volume {volume}");
        }
        let address = text(&service["environment"]["AWS_ENDPOINT_URL"]);
        let host = address.strip_prefix("http://").and_then(|rest| rest.split(':').next());
        assert!(host.is_none_or(|host| services.contains_key(host)), "{name} asks {address}");
    }
}

/// A manifest, and the file it is from.
struct Manifest {
    file: String,
    value: Value,
}

impl Manifest {
    fn is(&self, kind: &str) -> bool {
        self.value["kind"] == kind
    }

    fn name(&self) -> String {
        text(&self.value["metadata"]["name"])
    }
}

fn manifests() -> Vec<Manifest> {
    let [all] = &yaml(&format!("{MANIFESTS}/kustomization.yaml"))[..] else { panic!("one document") };
    let listed = texts(&all["resources"]);
    let entries = std::fs::read_dir(root().join(MANIFESTS)).expect("a folder");
    let names = entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned());
    let names: BTreeSet<_> =
        names.filter(|name| !["kustomization.yaml", "secrets.yaml"].contains(&&**name)).collect();
    assert_eq!(
        listed.iter().cloned().collect::<BTreeSet<_>>(),
        names,
        "what kustomization.yaml has, what there is"
    );
    let read = |file: String| {
        let values = yaml(&format!("{MANIFESTS}/{file}"));
        values.into_iter().map(move |value| Manifest { file: file.clone(), value })
    };
    listed.into_iter().chain(["secrets.yaml".to_owned()]).flat_map(read).collect()
}

/// The deployments, and what each starts.
fn deployments(all: &[Manifest]) -> Vec<(&Manifest, &Value)> {
    let deployments: Vec<_> = all.iter().filter(|one| one.is("Deployment")).collect();
    assert_eq!(deployments.len(), 2);
    deployments.into_iter().map(|one| (one, &one.value["spec"]["template"]["spec"])).collect()
}

/// The resource of a kind and a name that another refers to.
fn named<'a>(all: &'a [Manifest], kind: &str, name: &Value) -> &'a Value {
    let found = all.iter().find(|one| one.is(kind) && one.name() == text(name));
    &found.unwrap_or_else(|| panic!("there is no {kind} {name}")).value
}

/// What a container has in its environment, secrets by their forms.
fn environment(all: &[Manifest], container: &Value) -> Environment {
    let mut environment = Environment::new();
    for from in container["envFrom"].as_array().into_iter().flatten() {
        let secret = &from["secretRef"]["name"];
        let settings = &from["configMapRef"]["name"];
        environment.extend(if secret.is_string() {
            pairs(&named(all, "Secret", secret)["stringData"])
        } else {
            pairs(&named(all, "ConfigMap", settings)["data"])
        });
    }
    for one in container["env"].as_array().into_iter().flatten() {
        let secret = &one["valueFrom"]["secretKeyRef"];
        let value = if secret.is_object() {
            &named(all, "Secret", &secret["name"])["stringData"][text(&secret["key"])]
        } else {
            &one["value"]
        };
        environment.insert(text(&one["name"]), value.as_str().expect("a text").to_owned());
    }
    environment
}

#[test]
fn the_manifests_start_what_there_is() {
    let all = manifests();
    for (deployment, pod) in deployments(&all) {
        let (file, container) = (&deployment.file, &pod["containers"][0]);
        let words = texts(&container["args"]);
        let settings = check(file, &words, &environment(&all, container));
        assert_eq!(settings["jobs-running"] == "0", words[0] == "serve", "{file}: jobs are the workers'");
        let stop = pod["terminationGracePeriodSeconds"].as_f64().expect("seconds");
        assert!(stop > drain(&settings), "{file}: it would be killed before its end");
        assert_eq!(text(&pod["securityContext"]["runAsUser"]), image().user, "{file}");
        assert_eq!(text(&container["ports"][0]["containerPort"]), image().port, "{file}");
        assert_eq!(settings["temp-dir"], image().folder, "{file}");
        let mounts = texts_of(&container["volumeMounts"], "mountPath");
        assert!(mounts.contains(&settings["temp-dir"]), "{file}: {mounts:?}");
        let scratch = text(&pod["volumes"][0]["emptyDir"]["sizeLimit"]);
        let room = number(scratch.trim_end_matches("Gi")) * f64::from(1 << 30);
        assert!(
            room > number(&settings["max-temp-bytes"]),
            "{file}: its folder is smaller than it may think"
        );
    }
}

fn texts_of(list: &Value, member: &str) -> Vec<String> {
    list.as_array().into_iter().flatten().map(|one| text(&one[member])).collect()
}

#[test]
fn the_manifests_ask_for_paths_and_files_that_are_there() {
    let (all, serving) = (manifests(), Serving::start());
    for (deployment, pod) in deployments(&all) {
        let container = &pod["containers"][0];
        for probe in ["startupProbe", "readinessProbe", "livenessProbe"] {
            let path = text(&container[probe]["httpGet"]["path"]);
            ureq::get(format!("{}{path}", serving.url)).call().expect("it is well");
        }
        for volume in pod["volumes"].as_array().into_iter().flatten().filter(|one| one["secret"].is_object())
        {
            let mut mounts = container["volumeMounts"].as_array().into_iter().flatten();
            let mount = mounts.find(|mount| mount["name"] == volume["name"]).expect("it is mounted");
            let secret = named(&all, "Secret", &volume["secret"]["secretName"]);
            let files = secret["stringData"].as_object().expect("files").keys();
            let paths: Vec<_> = files.map(|file| format!("{}/{file}", text(&mount["mountPath"]))).collect();
            assert_eq!(paths, [KEYS], "{}", deployment.file);
            // Files of keys that everybody can read must not have any that are not hashed.
            assert_eq!(volume["secret"]["defaultMode"], 0o440);
        }
    }
}

/// Whether a selector's labels are all among those of some deployment's pods.
fn selects(all: &[Manifest], labels: &Value) -> bool {
    let wanted = pairs(labels);
    let has = |pods: Environment| wanted.iter().all(|(name, value)| pods.get(name) == Some(value));
    let pods = all.iter().filter(|one| one.is("Deployment"));
    !wanted.is_empty() && pods.map(|one| pairs(&one.value["spec"]["template"]["metadata"]["labels"])).any(has)
}

#[test]
fn the_manifests_fit_together() {
    let all = manifests();
    for Manifest { file, value } in &all {
        let spec = &value["spec"];
        let labels = match text(&value["kind"]).as_str() {
            "Service" => &spec["selector"],
            "NetworkPolicy" => &spec["podSelector"]["matchLabels"],
            "Deployment" | "PodDisruptionBudget" => &spec["selector"]["matchLabels"],
            _ => continue,
        };
        assert!(selects(&all, labels), "{file} selects nothing");
        for rule in spec["ingress"].as_array().into_iter().flatten() {
            assert_eq!(texts_of(&rule["ports"], "port"), [image().port], "{file}");
        }
    }
    let images = &yaml(&format!("{MANIFESTS}/kustomization.yaml"))[0]["images"];
    for (deployment, pod) in deployments(&all) {
        assert_eq!(pod["containers"][0]["image"], images[0]["name"], "{}", deployment.file);
        named(&all, "ServiceAccount", &pod["serviceAccountName"]);
    }
    assert_eq!(text(&images[0]["newTag"]), env!("CARGO_PKG_VERSION"));
}

#[test]
fn the_scaler_asks_the_database_of_the_workers() {
    let all = manifests();
    let scaler = &all.iter().find(|one| one.is("ScaledObject")).expect("a scaler").value["spec"];
    let worker = named(&all, "Deployment", &scaler["scaleTargetRef"]["name"]);
    assert!(worker["spec"].get("replicas").is_none(), "the scaler says how many there are");
    let container = &worker["spec"]["template"]["spec"]["containers"][0];
    let environment = environment(&all, container);
    let trigger = &scaler["triggers"][0];
    let asked = pairs(&trigger["metadata"]);
    let address = format!("postgres://densecloud@{}/{}", asked["host"], asked["dbName"]);
    assert_eq!(environment["DENSECLOUD_DATABASE"], address);
    let running = &check("worker.yaml", &texts(&container["args"]), &environment)["jobs-running"];
    assert_eq!(&asked["targetQueryValue"], running, "a worker for as many steps as it works on");
    let access = named(&all, "TriggerAuthentication", &trigger["authenticationRef"]["name"]);
    let password = &access["spec"]["secretTargetRef"][0];
    assert!(named(&all, "Secret", &password["name"])["stringData"][text(&password["key"])].is_string());
}
