// Draws /docs. Swagger would ask a site outside to judge the description: validatorUrl null keeps it from that.
SwaggerUIBundle({
  url: "/openapi.json",
  dom_id: "#swagger-ui",
  deepLinking: true,
  validatorUrl: null,
});
