#include "server/http/http_server.h"

#include <future>
#include <optional>
#include <thread>

#include <google/protobuf/util/json_util.h>
#include <httplib.h>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "core/image/layers.h"
#include "core/image/png_writer.h"
#include "server/coordinator/job_settings.h"
#include "server/coordinator/limits.h"
#include "server/http/index_page.h"
#include "server/http/metrics.h"

namespace tessera {
namespace {

constexpr float kExposureMaxEv = 64;
constexpr size_t kThreads = 4;
constexpr size_t kRequestBytesMax = 4096;

int HttpCode(const absl::Status& status) {
  switch (status.code()) {
    case absl::StatusCode::kNotFound: return 404;
    case absl::StatusCode::kInvalidArgument: return 400;
    case absl::StatusCode::kUnauthenticated: return 401;
    case absl::StatusCode::kPermissionDenied: return 403;
    case absl::StatusCode::kUnavailable: return 503;
    default: return 500;
  }
}

void Refuse(const absl::Status& status, httplib::Response& response) {
  response.status = HttpCode(status);
  response.set_content(absl::StrCat(status.message(), "\n"), "text/plain");
}

std::string Json(const google::protobuf::Message& message) {
  google::protobuf::util::JsonPrintOptions options;
  options.preserve_proto_field_names = true;
  std::string text;
  const auto status = google::protobuf::util::MessageToJsonString(message, &text, options);
  return status.ok() ? text : "{}";
}

// What a picture's URL asks for.
struct PictureQuery {
  std::string layer = "final";
  PixelRect region;
  DisplayTransform display{};
};

absl::StatusOr<PictureQuery> ParseQuery(const httplib::Request& request, const PixelRect& all) {
  PictureQuery query{.region = all};
  if (request.has_param("layer")) query.layer = request.get_param_value("layer");
  if (FindPictureLayer(query.layer) == nullptr) {
    return absl::InvalidArgumentError(
        "layer is unknown: give final, raw, albedo, normal, Z, id, samples, variance or error");
  }
  if (request.has_param("region")) {
    const std::string text = request.get_param_value("region");
    const std::vector<std::string> parts = absl::StrSplit(text, ',');
    int values[4] = {};
    bool ok = parts.size() == 4;
    for (size_t i = 0; ok && i < 4; ++i) ok = absl::SimpleAtoi(parts[i], &values[i]);
    for (const int value : values) ok = ok && value >= 0 && value <= kFrameSideMaxPx;
    query.region = PixelRect::FromSize(values[0], values[1], values[2], values[3]);
    if (!ok || query.region.empty() || !all.Contains(query.region)) {
      return absl::InvalidArgumentError(
          "region: give X,Y,W,H in pixels inside what the job renders");
    }
  }
  if (request.has_param("exposure")) {
    const std::string text = request.get_param_value("exposure");
    if (!absl::SimpleAtof(text, &query.display.exposure_ev) ||
        !(std::abs(query.display.exposure_ev) <= kExposureMaxEv)) {
      return absl::InvalidArgumentError("exposure: give stops between -64 and 64");
    }
  }
  return query;
}

// One value in [0, 1] out of a layer's value, for layers that are not colours.
float Shade(std::string_view layer, float value, float largest) {
  if (layer == "normal") return 0.5f * value + 0.5f;
  if (layer == "Z" || layer == "samples") return largest > 0 ? value / largest : 0;
  return value;
}

// A material id as a colour: neighbouring ids differ (the golden ratio's multiples).
float IdShade(uint32_t id, int channel) {
  const uint32_t hash = id * 2654435769u;
  return id == 0 ? 0 : static_cast<float>((hash >> (8 * channel)) & 255u) / 255.0f;
}

// The layer's channels as R, G, B (and A) for a PNG.
Image ForDisplay(const PictureLayer& layer, Image image) {
  Image out;
  out.data_window = out.display_window = image.data_window;
  const auto num_pixels = static_cast<size_t>(image.data_window.area());
  const char* const names[] = {"R", "G", "B", "A"};
  for (size_t c = 0; c < std::max<size_t>(3, layer.channels.size()); ++c) {
    const ImageChannel& from = image.channels[std::min(c, image.channels.size() - 1)];
    std::vector<float> values(num_pixels);
    float largest = 0;
    for (size_t i = 0; i < num_pixels; ++i) {
      values[i] = !from.is_uint              ? from.floats[i]
                  : layer.name == "id"       ? IdShade(from.uints[i], static_cast<int>(c))
                                             : static_cast<float>(from.uints[i]);
      largest = std::max(largest, values[i]);
    }
    for (float& value : values) value = Shade(layer.name, value, largest);
    out.Add(names[c], std::move(values));
  }
  return out;
}

}  // namespace

class HttpServer::Impl {
 public:
  Impl(const TlsFiles& tls, CoordinatorHost& host, PictureService& pictures, const Access& access)
      : host_(host),
        pictures_(pictures),
        access_(access),
        server_(tls.enabled()
                    ? std::make_unique<httplib::SSLServer>(tls.cert.c_str(), tls.key.c_str())
                    : std::make_unique<httplib::Server>()) {}

  absl::Status Start(const std::string& address);
  void Stop() {
    server_->stop();
    if (thread_.joinable()) thread_.join();
  }
  int port_ = 0;

 private:
  void AddRoutes();
  absl::StatusOr<v1::Job> GetJob(const httplib::Request& request) const;
  absl::Status SendPicture(const httplib::Request& request, httplib::Response& response);

  CoordinatorHost& host_;
  PictureService& pictures_;
  const Access& access_;
  const std::unique_ptr<httplib::Server> server_;
  std::thread thread_;
};

absl::Status HttpServer::Impl::Start(const std::string& address) {
  const size_t colon = address.rfind(':');
  int port = -1;
  if (colon == std::string::npos || !absl::SimpleAtoi(address.substr(colon + 1), &port) ||
      port < 0 || port > 65535) {
    return absl::InvalidArgumentError(
        absl::StrCat("--http ", address, " is no address: give HOST:PORT, or off"));
  }
  std::string name = address.substr(0, colon);
  if (name.size() > 2 && name.front() == '[') name = name.substr(1, name.size() - 2);
  server_->new_task_queue = [] { return new httplib::ThreadPool(kThreads); };
  server_->set_payload_max_length(kRequestBytesMax);
  // Not SO_REUSEPORT, httplib's default: a second server would share the port unseen.
  server_->set_socket_options([](socket_t socket) {
    const int yes = 1;
    setsockopt(socket, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof(yes));
  });
  AddRoutes();
  port_ = port == 0 ? server_->bind_to_any_port(name.c_str())
                    : (server_->bind_to_port(name.c_str(), port) ? port : -1);
  if (port_ <= 0) {
    return absl::UnavailableError(absl::StrCat(
        "cannot listen on --http ", address, ": the address is in use or not this machine's; "
        "choose another, such as 127.0.0.1:0 for any free port, or --http off"));
  }
  thread_ = std::thread([this] { server_->listen_after_bind(); });
  return absl::OkStatus();
}

absl::StatusOr<v1::Job> HttpServer::Impl::GetJob(const httplib::Request& request) const {
  const absl::StatusOr<JobId> id = ParseJobName("jobs/" + request.matches[1].str());
  if (!id.ok()) return id.status();
  return host_.Read([&](const Coordinator& c) { return c.GetJob(*id); });
}

absl::Status HttpServer::Impl::SendPicture(const httplib::Request& request,
                                           httplib::Response& response) {
  const absl::StatusOr<v1::Job> job = GetJob(request);
  if (!job.ok()) return job.status();
  const absl::StatusOr<PictureQuery> query = ParseQuery(request, RegionOf(job->settings()));
  if (!query.ok()) return query.status();

  std::promise<std::shared_ptr<const Picture>> promise;
  std::optional<PixelRect> part;
  if (query->region != RegionOf(job->settings())) part = query->region;
  pictures_.Fetch(*ParseJobName(job->name()), part, false,
                  [&](std::shared_ptr<const Picture> picture) { promise.set_value(picture); });
  const std::shared_ptr<const Picture> picture = promise.get_future().get();
  if (picture == nullptr) return absl::UnavailableError("the job is gone or the server stops");
  const std::string etag =
      absl::StrCat("\"", job->revision().incarnation(), "-", picture->serial(), "-",
                   picture->version(), "\"");
  response.set_header("ETag", etag);
  response.set_header("Cache-Control", "no-cache");
  if (request.get_header_value("If-None-Match") == etag) {
    response.status = 304;
    return absl::OkStatus();
  }
  absl::StatusOr<Image> image = picture->Snapshot(query->region, {query->layer});
  if (!image.ok()) return image.status();
  const absl::StatusOr<std::string> png =
      EncodePng(ForDisplay(*FindPictureLayer(query->layer), *std::move(image)), query->display);
  if (!png.ok()) return png.status();
  response.set_content(*png, "image/png");
  return absl::OkStatus();
}

void HttpServer::Impl::AddRoutes() {
  using Handled = httplib::Server::HandlerResponse;
  server_->set_pre_routing_handler([this](const httplib::Request& request,
                                          httplib::Response& response) {
    if (request.path == "/healthz") return Handled::Unhandled;
    const absl::Status status =
        access_.CheckHeader(request.get_header_value("Authorization"), Role::kView).status();
    if (status.ok()) return Handled::Unhandled;
    if (absl::IsUnauthenticated(status)) {
      response.set_header("WWW-Authenticate", "Basic realm=\"tessera: any name, and a token\"");
    }
    Refuse(status, response);
    return Handled::Handled;
  });
  server_->Get("/healthz", [](const httplib::Request&, httplib::Response& response) {
    response.set_content("ok\n", "text/plain");
  });
  server_->Get("/metrics", [this](const httplib::Request&, httplib::Response& response) {
    response.set_content(MetricsText(host_, pictures_.filter_totals()), kMetricsContentType);
  });
  server_->Get("/", [](const httplib::Request&, httplib::Response& response) {
    response.set_content(kIndexPage, "text/html; charset=utf-8");
  });
  server_->Get("/jobs", [this](const httplib::Request& request, httplib::Response& response) {
    JobId after = 0;
    if (request.has_param("after") &&
        !absl::SimpleAtoi(request.get_param_value("after"), &after)) {
      return Refuse(absl::InvalidArgumentError("after: give the N of a jobs/N"), response);
    }
    v1::ListJobsResponse list;
    for (v1::Job& job : host_.Read([&](const Coordinator& c) {
           return c.ListJobs(after, kListPageMax, kListPageBytesMax);
         })) {
      *list.add_jobs() = std::move(job);
    }
    response.set_content(Json(list), "application/json");
  });
  server_->Get(R"(/jobs/(\d+))", [this](const httplib::Request& request,
                                       httplib::Response& response) {
    const absl::StatusOr<v1::Job> job = GetJob(request);
    if (!job.ok()) return Refuse(job.status(), response);
    response.set_content(Json(*job), "application/json");
  });
  server_->Get(R"(/jobs/(\d+)/image\.png)", [this](const httplib::Request& request,
                                                  httplib::Response& response) {
    const absl::Status status = SendPicture(request, response);
    if (!status.ok()) Refuse(status, response);
  });
}

HttpServer::HttpServer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
HttpServer::~HttpServer() { Stop(); }

absl::StatusOr<std::unique_ptr<HttpServer>> HttpServer::Start(const std::string& address,
                                                              const TlsFiles& tls,
                                                              CoordinatorHost& host,
                                                              PictureService& pictures,
                                                              const Access& access) {
  auto impl = std::make_unique<Impl>(tls, host, pictures, access);
  if (absl::Status status = impl->Start(address); !status.ok()) return status;
  return std::unique_ptr<HttpServer>(new HttpServer(std::move(impl)));
}

int HttpServer::port() const { return impl_->port_; }
void HttpServer::Stop() { impl_->Stop(); }

}  // namespace tessera
