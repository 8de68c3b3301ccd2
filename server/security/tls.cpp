#include "server/security/tls.h"

#include <openssl/err.h>
#include <openssl/pem.h>
#include <openssl/x509.h>

#include <fstream>
#include <iterator>
#include <utility>

#include "absl/strings/str_cat.h"

namespace tessera {
namespace {

struct OpenSslDeleter {
  void operator()(BIO* bio) const { BIO_free(bio); }
  void operator()(X509* certificate) const { X509_free(certificate); }
  void operator()(EVP_PKEY* key) const { EVP_PKEY_free(key); }
};
template <typename T>
using OpenSslPtr = std::unique_ptr<T, OpenSslDeleter>;

absl::Status Bad(const char* flag, const std::string& path, const std::string& why) {
  ERR_clear_error();
  return absl::InvalidArgumentError(absl::StrCat(flag, " ", path, ": ", why));
}

absl::StatusOr<std::string> ReadPem(const char* flag, const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::string text{std::istreambuf_iterator<char>(file), {}};
  if (!file || text.empty()) return Bad(flag, path, "cannot be read or is empty: check the path");
  return text;
}

OpenSslPtr<X509> ParseCertificate(const std::string& pem) {
  const OpenSslPtr<BIO> bio(BIO_new_mem_buf(pem.data(), static_cast<int>(pem.size())));
  return OpenSslPtr<X509>(PEM_read_bio_X509(bio.get(), nullptr, nullptr, nullptr));
}

// What gRPC would only say by failing handshakes.
absl::Status CheckPair(const TlsFiles& files, const std::string& cert, const std::string& key) {
  const OpenSslPtr<X509> certificate = ParseCertificate(cert);
  if (certificate == nullptr) return Bad("--tls-cert", files.cert, "holds no PEM certificate");
  if (X509_cmp_current_time(X509_get0_notAfter(certificate.get())) < 0) {
    return Bad("--tls-cert", files.cert, "has expired: have it renewed");
  }
  if (X509_cmp_current_time(X509_get0_notBefore(certificate.get())) > 0) {
    return Bad("--tls-cert", files.cert, "is not valid yet: check this machine's clock");
  }
  const OpenSslPtr<BIO> bio(BIO_new_mem_buf(key.data(), static_cast<int>(key.size())));
  // An empty passphrase: nobody is there to type one.
  char no_passphrase[] = "";
  const OpenSslPtr<EVP_PKEY> private_key(
      PEM_read_bio_PrivateKey(bio.get(), nullptr, nullptr, no_passphrase));
  if (private_key == nullptr) {
    return Bad("--tls-key", files.key, "holds no PEM key without a passphrase");
  }
  if (X509_check_private_key(certificate.get(), private_key.get()) != 1) {
    return Bad("--tls-key", files.key, absl::StrCat("is not the key of ", files.cert));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<std::shared_ptr<grpc::ServerCredentials>> MakeServerCredentials(
    const TlsFiles& files) {
  if (files.cert.empty() != files.key.empty()) {
    return absl::InvalidArgumentError("--tls-cert and --tls-key belong together: give both");
  }
  if (!files.enabled()) {
    if (files.client_ca.empty()) return grpc::InsecureServerCredentials();
    return absl::InvalidArgumentError(
        "--client-ca needs TLS: give --tls-cert and --tls-key as well");
  }
  absl::StatusOr<std::string> cert = ReadPem("--tls-cert", files.cert);
  if (!cert.ok()) return cert.status();
  absl::StatusOr<std::string> key = ReadPem("--tls-key", files.key);
  if (!key.ok()) return key.status();
  if (absl::Status status = CheckPair(files, *cert, *key); !status.ok()) return status;
  grpc::SslServerCredentialsOptions options(GRPC_SSL_DONT_REQUEST_CLIENT_CERTIFICATE);
  if (!files.client_ca.empty()) {
    absl::StatusOr<std::string> authority = ReadPem("--client-ca", files.client_ca);
    if (!authority.ok()) return authority.status();
    if (ParseCertificate(*authority) == nullptr) {
      return Bad("--client-ca", files.client_ca, "holds no PEM certificate");
    }
    options.pem_root_certs = *std::move(authority);
    // Clients may come with a token instead; Access decides who needs which.
    options.client_certificate_request = GRPC_SSL_REQUEST_CLIENT_CERTIFICATE_AND_VERIFY;
  }
  options.pem_key_cert_pairs.push_back({*std::move(key), *std::move(cert)});
  return grpc::SslServerCredentials(options);
}

}  // namespace tessera
