#include "client/cli/command_line.h"

#include <cstdio>
#include <string>

#include <CLI/CLI.hpp>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "client/cli/commands.h"
#include "client/cli/completion.h"
#include "client/cli/exit_code.h"
#include "client/cli/flags.h"
#include "core/base/isa_classes.h"
#include "core/base/version.h"
#include "core/denoise/denoiser.h"
#include "core/image/layers.h"

namespace tessera {
namespace {

std::vector<std::string> LayerNames() {
  std::vector<std::string> names;
  for (const PictureLayer& layer : PictureLayers()) names.emplace_back(layer.name);
  return names;
}

std::string DenoiserHelp() {
  const std::vector<std::string> names = DenoiserNames();
  return absl::StrCat("Filter of the final picture: ", absl::StrJoin(names, ", "), " (",
                      names.front(), ")");
}

void AddConnectFlags(CLI::App* command, ConnectFlags* flags) {
  const std::string group = "Server";
  command->add_option("--server", flags->server, "HOST:PORT of a tessera-server")->group(group);
  SecurityFlags& security = flags->security;
  command->add_option("--token-file", security.token_file, "File with the bearer token")
      ->envname("TESSERA_TOKEN_FILE")
      ->group(group);
  command->add_option("--ca", security.ca, "Certificates to trust (PEM): speaks TLS")
      ->envname("TESSERA_CA")
      ->group(group);
  command->add_option("--cert", security.cert, "This client's certificate (PEM)")
      ->envname("TESSERA_CERT")
      ->group(group);
  command->add_option("--key", security.key, "Its key (PEM)")
      ->envname("TESSERA_KEY")
      ->group(group);
  command->add_flag("--insecure", security.insecure, "Allow plaintext beyond this machine")
      ->group(group);
}

void AddOutputFlags(CLI::App* command, OutputFlags* flags) {
  const std::string group = "Output";
  command->add_option("-o,--output", flags->paths, "OUT.exr or OUT.png; may be repeated")
      ->allow_extra_args(false)
      ->group(group);
  command
      ->add_option("--layers", flags->layers,
                   absl::StrCat("Layers of EXR files, comma-separated: ",
                                absl::StrJoin(LayerNames(), ", "),
                                "; or all (default); or film: all, and what a render can be "
                                "continued and denoised from"))
      ->group(group);
  command->add_option("--exposure", flags->exposure, "Stops by which PNG files are brightened")
      ->group(group);
}

void AddSceneFlags(CLI::App* command, SceneFlags* flags) {
  command->add_option("scene", flags->scene, "SCENE.glb or SCENE.gltf")->required();
  const auto add = [command](const std::string& group, const std::string& name, std::string* value,
                             const std::string& text) {
    command->add_option(name, *value, text)->group(group);
  };
  add("Camera", "--camera", &flags->camera, "Name of a camera of the scene");
  add("Camera", "--look-from", &flags->look_from, "X,Y,Z of the eye, metres");
  add("Camera", "--look-at", &flags->look_at, "X,Y,Z that it looks at");
  add("Camera", "--up", &flags->up, "X,Y,Z that is up (0,1,0)");
  add("Camera", "--fov-y", &flags->fov_y, "Vertical field of view, degrees");
  add("Camera", "--lens-radius", &flags->lens_radius, "Metres; 0 = pinhole");
  add("Camera", "--focus-distance", &flags->focus_distance, "Metres");
  add("Frame", "--size", &flags->size, "WIDTHxHEIGHT in pixels (640x360)");
  add("Frame", "--region", &flags->region, "X,Y,W,H: render only these pixels");
  add("Frame", "--look", &flags->look,
      "X,Y,W,H: render these pixels before the others; moves no bit of the picture");
  add("Frame", "--tile-size", &flags->tile_size, "Pixels; moves no bit of the picture");
  add("Sampling", "--spp", &flags->spp,
      "Samples per pixel (64; with --target-error or --max-time: as many as it takes)");
  add("Sampling", "--target-error", &flags->target_error,
      "Stop at this relative RMSE of the final picture, such as 0.02");
  add("Sampling", "--target-tile-error", &flags->target_tile_error,
      "Stop at this relative RMSE of every cell of 16x16 pixels and those around it");
  add("Sampling", "--sampling", &flags->sampling,
      "adaptive: more where the picture needs it; or uniform (adaptive with a target error)");
  add("Sampling", "--max-time", &flags->max_time, "Stop after so many seconds");
  add("Sampling", "--max-depth", &flags->max_depth,
      "Bounces after the camera hit (8); auto: as many as the picture's error needs");
  add("Sampling", "--feature-spp", &flags->feature_spp,
      "Samples of a pixel that carry albedo, normal, depth and id; all or 0 = every one (64)");
  add("Sampling", "--seed", &flags->seed, "Another seed, another noise (0)");
  add("Sampling", "--isa", &flags->isa,
      absl::StrCat("Instruction set that decides the bits: ", absl::StrJoin(kIsaClasses, ", "),
                   " (", std::string(kIsaClasses.front()), ")"));
  add("Sampling", "--arithmetic", &flags->arithmetic,
      "Processor arithmetic that decides the last bits, as 'tessera workers' shows it: only such "
      "workers may render; any = not that of the picture to --replay (any)");
  add("Light", "--env", &flags->env, "Environment map, latitude-longitude .hdr or .exr");
  add("Light", "--env-rotate", &flags->env_rotate, "Degrees by which it is turned about y");
  add("Light", "--sky", &flags->sky, "R,G,B: uniform sky radiance");
  command->add_flag("--transparent", flags->transparent, "Alpha 0 where the sky is seen")
      ->group("Light");
  add("Serving", "--denoiser", &flags->denoiser, DenoiserHelp());
  add("Serving", "--quality", &flags->quality, "preview or final (final)");
  add("Serving", "--priority", &flags->priority, "Higher is rendered first (0)");
  add("Sampling", "--continue", &flags->continue_film,
      "FILM.exr whose samples are taken up; flags that are not given come from it");
  add("Sampling", "--replay", &flags->replay,
      "PICTURE.exr that is rendered again, sample for sample: the same digest; flags that are not "
      "given come from it");
}

void AddJobFlags(CLI::App* command, JobFlags* flags, bool names_job) {
  if (names_job) command->add_option("job", flags->job, "jobs/N or N")->required();
  command->add_flag("--json", flags->json, "One JSON object on stdout");
  AddConnectFlags(command, &flags->connect);
}

void AddHalvesFlags(CLI::App* command, HalvesFlags* flags) {
  const auto add = [command](const std::string& name, std::string* value, const std::string& text) {
    command->add_option(name, *value, text)->group("Halves of any renderer");
  };
  add("--half-a", &flags->half_a, "A.exr: R,G,B of half the samples");
  add("--half-b", &flags->half_b, "B.exr: the same with another seed");
  add("--variance", &flags->variance, "Variance of the mean of both (R,G,B)");
  add("--spp", &flags->spp, "Samples of a pixel in both halves together");
  const auto add_feature = [&add](const std::string& name, FeatureFlags* feature,
                                  const std::string& text) {
    add("--" + name, &feature->file, text + ": of all samples, or of half A");
    add("--" + name + "-b", &feature->file_b, "The same of half B");
    add("--" + name + "-variance", &feature->variance, "Variance of its mean over all samples");
  };
  add_feature("albedo", &flags->albedo, "Albedo (R,G,B)");
  add_feature("normal", &flags->normal, "Shading normal (X,Y,Z or R,G,B)");
  add_feature("depth", &flags->depth, "Distance along the ray (Z, Y or one channel)");
}

// All flags of all commands, and which command was chosen.
class CommandTable {
 public:
  explicit CommandTable(const CommandLineParts& parts) : parts_(parts) {
    app_.name("tessera");
    app_.require_subcommand(1);
    app_.set_version_flag("--version", std::string("tessera ") + kVersion);
    app_.set_help_flag("-h,--help", "This text");
    AddRenderCommands();
    AddJobCommands();
    AddFileCommands();
    // An empty value is an unset variable of a script: it must not pass for a flag not given.
    const CLI::Validator not_empty(
        [](std::string& value) { return value.empty() ? "its value is empty" : ""; }, "");
    for (CLI::App* command : app_.get_subcommands([](const CLI::App*) { return true; })) {
      for (CLI::Option* option : command->get_options()) {
        if (option->get_expected_max() > 0) option->check(not_empty);
      }
    }
  }

  CLI::App& app() { return app_; }
  absl::Status Run() { return chosen_(); }

 private:
  template <typename Action>
  CLI::App* Add(const std::string& name, const std::string& text, Action action) {
    CLI::App* command = app_.add_subcommand(name, text);
    command->callback([this, action] { chosen_ = action; });
    return command;
  }

  void AddRenderCommands() {
    CLI::App* render = Add("render", "Render a scene, here or on a server",
                           [this] { return RunRender(render_, parts_); });
    AddSceneFlags(render, &render_.scene);
    AddOutputFlags(render, &render_.output);
    render->add_option("--threads", render_.threads, "Threads without --server (all)");
    render->add_flag("--json", render_.json, "One JSON object with the figures on stdout");
    render->add_flag("--quiet", render_.quiet, "No progress, no notes, no summary");
    AddConnectFlags(render, &render_.connect);

    CLI::App* submit = Add("submit", "Create a job on a server and print its name",
                           [this] { return RunSubmit(render_); });
    AddSceneFlags(submit, &render_.scene);
    submit->add_flag("--json", render_.json, "The job as a JSON object on stdout");
    submit->add_flag("--quiet", render_.quiet, "No progress");
    AddConnectFlags(submit, &render_.connect);
  }

  void AddJobCommands() {
    AddJobFlags(Add("list", "All jobs of a server", [this] { return RunList(job_); }), &job_,
                false);
    AddJobFlags(Add("show", "One job in detail", [this] { return RunShow(job_); }), &job_, true);
    CLI::App* watch =
        Add("watch", "Show a job's progress until it ends", [this] { return RunWatch(watch_); });
    AddJobFlags(watch, &watch_.job, true);
    watch->add_option("--region", watch_.region,
                      "X,Y,W,H: the part of the picture that is looked at (all)");
    watch->add_flag("--quiet", watch_.job.quiet,
                    "No progress, and no previews but of --region for this watcher");
    CLI::App* fetch = Add("fetch", "Write a job's picture as it is now",
                          [this] { return RunFetch(fetch_); });
    fetch->add_option("job", fetch_.job, "jobs/N or N")->required();
    fetch->add_option("--region", fetch_.region, "X,Y,W,H: only these pixels")->group("Output");
    fetch->add_flag("--json", fetch_.json, "The job and the outputs as one JSON object on stdout");
    AddOutputFlags(fetch, &fetch_.output);
    AddConnectFlags(fetch, &fetch_.connect);
    CLI::App* look = Add("look", "Say what a job shall render first from now on",
                         [this] { return RunLook(look_); });
    AddJobFlags(look, &look_.job, true);
    look->add_option("region", look_.region, "X,Y,W,H in pixels of the frame, or none")->required();
    AddJobFlags(Add("pause", "Hand out no more of a job", [this] { return RunPause(job_); }), &job_,
                true);
    AddJobFlags(Add("resume", "Go on with a paused job", [this] { return RunResume(job_); }), &job_,
                true);
    AddJobFlags(Add("cancel", "End a job; its picture stays", [this] { return RunCancel(job_); }),
                &job_, true);
    AddJobFlags(Add("delete", "Remove a job and its picture", [this] { return RunDelete(job_); }),
                &job_, true);
    AddJobFlags(Add("workers", "The workers of a server", [this] { return RunWorkers(job_); }),
                &job_, false);
  }

  void AddFileCommands() {
    CLI::App* denoise = Add("denoise", "Filter a film again, or two halves of any renderer",
                            [this] { return RunDenoise(denoise_); });
    denoise->add_option("film", denoise_.inputs, "FILM.exr, or HALF_A.exr HALF_B.exr")
        ->expected(1, 2);
    AddHalvesFlags(denoise, &denoise_.halves);
    denoise->add_option("--denoiser", denoise_.denoiser, DenoiserHelp());
    denoise->add_option("--quality", denoise_.quality, "preview or final (final)");
    denoise
        ->add_option("--denoiser-option", denoise_.options,
                     "NAME=VALUE: sets a number of the filter; may be repeated")
        ->allow_extra_args(false);
    denoise->add_flag("--list", denoise_.list, "Print the filters and what can be set, and end");
    denoise->add_flag("--json", denoise_.json, "The outputs as one JSON object on stdout");
    AddOutputFlags(denoise, &denoise_.output);

    CLI::App* compare = Add("compare", "Error of a picture against one or two references",
                            [this] { return RunCompare(compare_); });
    compare->add_option("image", compare_.image, "PICTURE.exr")->required();
    compare
        ->add_option("reference", compare_.references,
                     "REFERENCE.exr, and an independent second one to take out its noise")
        ->required()
        ->expected(1, 2);
    compare->add_flag("--json", compare_.json, "One JSON object on stdout");

    CLI::App* info = Add("info", "What a scene needs", [this] { return RunInfo(info_, parts_); });
    info->add_option("scene", info_.scene, "SCENE.glb or SCENE.gltf")->required();
    info->add_flag("--json", info_.json, "One JSON object on stdout");

    CLI::App* chart = Add("chart", "Chart speed against accuracy of every filter on your scenes",
                          [this] { return RunChart(chart_arguments_); });
    chart->add_option("arguments", chart_arguments_, "See 'tessera chart --help'")
        ->allow_extra_args();

    Add("completion", "Print the completion script for bash: source <(tessera completion)",
        [this] { return PrintCompletion(); });
  }

  absl::Status PrintCompletion() {
    std::vector<CompletedCommand> commands;
    for (const CLI::App* command : app_.get_subcommands([](const CLI::App*) { return true; })) {
      CompletedCommand completed{command->get_name(), {}};
      for (const CLI::Option* option : command->get_options()) {
        for (const std::string& name : option->get_lnames()) {
          completed.flags.push_back("--" + name);
        }
      }
      commands.push_back(std::move(completed));
    }
    std::vector<std::string> layers = {"all", "film"};
    for (const std::string& layer : LayerNames()) layers.push_back(layer);
    const std::string script =
        BashCompletion(commands, {{"--quality", {"preview", "final"}},
                                  {"--denoiser", DenoiserNames()},
                                  {"--isa", {kIsaClasses.begin(), kIsaClasses.end()}},
                                  {"--layers", layers}});
    std::fputs(script.c_str(), stdout);
    return absl::OkStatus();
  }

  const CommandLineParts& parts_;
  CLI::App app_{"Renders glTF scenes, here or on as many machines as there are."};
  RenderFlags render_;
  JobFlags job_;
  WatchFlags watch_;
  LookFlags look_;
  FetchFlags fetch_;
  DenoiseFlags denoise_;
  CompareFlags compare_;
  std::vector<std::string> chart_arguments_;
  InfoFlags info_;
  std::function<absl::Status()> chosen_;
};

void PrintError(const std::string& message) {
  // One line, whatever a file or peer put into it.
  std::string line = message;
  for (char& c : line) {
    if (static_cast<unsigned char>(c) < ' ') c = ' ';
  }
  std::fprintf(stderr, "tessera: %s\n", line.c_str());
}

}  // namespace

int RunCommandLine(int argc, const char* const* argv, const CommandLineParts& parts) {
  if (argc > 1 && std::string_view(argv[1]) == "chart") {
    // Its flags are its own program's.
    const absl::Status status = RunChart({argv + 2, argv + argc});
    PrintError(std::string(status.message()));
    return ExitCodeOf(status);
  }
  CommandTable table(parts);
  try {
    table.app().parse(argc, argv);
  } catch (const CLI::Success& help_or_version) {
    return table.app().exit(help_or_version);
  } catch (const CLI::ParseError& error) {
    if (argc > 1 && argv[1][0] != '-' && table.app().get_subcommands().empty()) {
      PrintError(absl::StrCat("'", argv[1], "' is no command: 'tessera --help' lists them all"));
      return kExitBadInput;
    }
    PrintError(absl::StrCat(error.what(), ": see 'tessera --help' or 'tessera COMMAND --help'"));
    return kExitBadInput;
  }
  const absl::Status status = table.Run();
  if (!status.ok()) PrintError(std::string(status.message()));
  if (std::fflush(stdout) != 0 && status.ok()) {
    PrintError("stdout cannot be written: check the disk or the pipe");
    return kExitBadInput;
  }
  return ExitCodeOf(status);
}

}  // namespace tessera
